"""Optimal control values V_oc and their files."""
