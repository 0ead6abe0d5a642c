"""Proof that the physics is right: probes of an engine against closed forms, and what a vehicle can follow."""
