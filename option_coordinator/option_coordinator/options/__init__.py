"""Options, and the decisions at which they are chosen (thesis 2.4)."""
