"""Read scans, odometry and commands of a bag as arrays at the times of the scans.

python examples/align_bag.py BAG
"""

import sys

import numpy as np

from ctrl_rl_bags import align, bag_info

bag = sys.argv[1]
info = bag_info(bag)
print(f"{info.message_count} messages on {len(info.topics)} topics")
for index, run in enumerate(align(bag, ["/scan", "/odom", "/cmd_vel"], reference="/scan", max_age=0.5)):
    odometry, commands = run.values["/odom"], run.values["/cmd_vel"]  # x, y, yaw, v, omega; v, omega
    oldest = run.ages["/cmd_vel"].max()
    nearest = [np.min(scan.ranges) for scan in run.values["/scan"]]
    print(f"sequence {index}: {len(run)} scans in {run.seconds[-1]:.1f} s, oldest command {oldest:.2f} s")
    print(f"  odometry {odometry.shape}, commands {commands.shape}, nearest echo {min(nearest):.2f} m")
