"""How good a policy is, and what physics costs it."""
