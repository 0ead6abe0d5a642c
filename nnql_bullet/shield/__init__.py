"""The shield around a policy."""
