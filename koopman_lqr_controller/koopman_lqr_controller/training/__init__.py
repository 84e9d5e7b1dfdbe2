"""Task-oriented learning (thesis 4.2): what no robot needs; imports torch."""
