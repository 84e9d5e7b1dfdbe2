"""Certificates of times to reach: drives and paths back that a solution has to agree with."""
