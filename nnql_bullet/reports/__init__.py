"""Reports on runs, recordings and evaluations: text, tables, pictures and pages."""
