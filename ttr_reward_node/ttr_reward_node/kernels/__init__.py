"""Compiled kernels that sweep over a grid."""
