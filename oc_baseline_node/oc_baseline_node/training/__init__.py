"""Learning with V_oc as baseline, and what it is compared with (thesis 3.3.3). Robots need none of it."""
