"""Verdicts from bags beside what the policies then do."""
