"""Writes reports on runs, recordings and evaluations: text, tables, pictures and pages."""
