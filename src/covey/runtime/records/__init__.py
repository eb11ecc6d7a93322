"""Files: results, records of a run, and their formats."""
