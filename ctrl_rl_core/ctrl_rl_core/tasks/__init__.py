"""Tasks as validated YAML: regions, starts, outcomes, and the schema of each part."""
