"""Task-oriented learning (thesis 4.2); imports torch, which no robot needs."""
