"""The functions that `import nnql_bullet` offers: each runs one study and returns its results."""
