"""Value data from solved trajectories, and the fit of V_oc to them (thesis 3.3.2)."""
