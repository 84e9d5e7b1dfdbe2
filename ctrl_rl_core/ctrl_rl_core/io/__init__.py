"""Files: checked reading, atomic writing, results."""
