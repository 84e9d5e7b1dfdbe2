"""Model mismatch and gradient estimates (thesis Tables 3.5 and 3.7, Fig. 3.17)."""
