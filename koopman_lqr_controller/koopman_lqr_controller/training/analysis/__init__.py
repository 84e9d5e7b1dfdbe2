"""Control-theoretic analysis of a policy (thesis 4.3.3)."""
