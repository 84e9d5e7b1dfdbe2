"""Drive, record, relabel, learn, evaluate, and drive again."""
