from .decomposition import solve_parts as solve_parts
