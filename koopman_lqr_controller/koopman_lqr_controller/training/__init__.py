"""Task-oriented learning (thesis 4.2); requires torch, unlike the code on robots."""
