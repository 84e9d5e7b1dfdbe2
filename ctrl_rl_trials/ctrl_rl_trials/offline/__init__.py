"""Closed loops from bags: drive, learn, evaluate, drive again."""
