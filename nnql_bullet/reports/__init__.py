"""Reports: what people look at, drawn from runs and recordings."""
