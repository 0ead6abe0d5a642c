"""Rules: policies that never learn."""
