"""Learning with time-to-reach rewards (thesis 3.2.3)."""
