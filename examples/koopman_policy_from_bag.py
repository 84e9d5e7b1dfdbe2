"""Learn a linear model and its LQR from a recorded drive, inspect both, and save them as a policy.

python examples/koopman_policy_from_bag.py BAG [POLICY]

Drive with it: ros2 run ctrl_rl_bringup demo --policy POLICY
"""

import sys
from pathlib import Path

import numpy as np
from koopman_lqr_controller.data import mean_time_step

from ctrl_rl_core import load_navigation_task
from koopman_lqr_controller import CorridorObservables, load_segments, save_policy, to_snapshots, train

bag = Path(sys.argv[1])
output = Path(sys.argv[2] if len(sys.argv) > 2 else "policy.safetensors")
commands = load_navigation_task("curved_corridor").robot.commands
observables = CorridorObservables()
segments = load_segments(bag, observables.observe)
print(f"{sum(map(len, segments))} steps in {len(segments)} segments")

policy = train(
    to_snapshots(segments),
    observables,
    speed=0.18,  # m/s
    limits=(commands["v"], commands["omega"]),
    manifest={"dt": mean_time_step(segments)},
)
poles = np.linalg.eigvals(policy.loop)
print(f"one-step error {policy.manifest['error_over_persistence']:.2f} of that of 'nothing changes'")
print(f"slowest poles of the closed loop: {np.sort(np.abs(poles))[::-1][:3].round(3)}")
save_policy(policy, output, overwrite=True)
print(f"policy: {output}")
