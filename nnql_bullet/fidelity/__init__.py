"""Tests of the physics: probes compare an engine with closed forms, and measure the turns that a vehicle can follow."""
