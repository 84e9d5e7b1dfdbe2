"""Robot implemented from the text of ctrl_rl_msgs/msg alone, with plain rclpy and no code of the suite."""

import sys
import time

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, OptionGrant, OptionRequest

QOS = QoSProfile(
    depth=1000,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
REPEAT_S, HEARTBEAT_S, PATIENCE_S = 0.1, 0.1, 2.0
RISE, LARGEST_LEAP = 16 * 2**32, 2**61
OPTIONS, OBSERVATION, LASTS_S = 3, [0.5, -0.5], 0.2


class PlainRobot(Node):
    """Options of 0.2 s each; option 0 is the safe one."""

    def __init__(self, name, team):
        super().__init__(f"plain_{name}")
        self.agent, self.team = name, team
        self.incarnation = time.time_ns()
        self.epoch, self.leap = 0, (0, 0.0)
        self.state, self.grant = AgentStatus.WAITING, None
        self.requests = self.create_publisher(OptionRequest, "option_requests", QOS)
        self.statuses = self.create_publisher(AgentStatus, "agent_status", QOS)
        self.create_subscription(OptionGrant, "option_grants", self.on_grant, QOS)
        self.create_subscription(CoordinatorStatus, "coordinator_status", self.on_coordinator_heartbeat, QOS)
        self.request = OptionRequest(request_id=0)
        self.ask()
        self.create_timer(0.02, self.tick)

    def ask(self, reward=0.0, steps=0):
        """Send a new request with the current observation."""
        self.request = OptionRequest(
            agent=self.agent,
            incarnation=self.incarnation,
            request_id=self.request.request_id + 1,
            observation=OBSERVATION,
            legal=[True] * OPTIONS,
            option_reward=reward,
            option_duration=steps,
            team=self.team,
        )
        self.request.header.stamp = self.get_clock().now().to_msg()
        self.state, self.asked = AgentStatus.WAITING, time.monotonic()
        self.say_at = self.beat_at = time.monotonic()

    def believes(self, epoch):
        """Whether an epoch is trusted (see CoordinatorStatus.msg)."""
        now = time.monotonic()
        first = self.epoch == 0 and epoch < LARGEST_LEAP
        if first or epoch <= self.epoch + RISE:
            self.epoch = max(self.epoch, epoch)
            return True
        if epoch != self.leap[0]:
            self.leap = (epoch, now)
        elif epoch < LARGEST_LEAP and now - self.leap[1] >= PATIENCE_S:
            self.epoch = epoch
            return True
        return False

    def on_coordinator_heartbeat(self, message):
        if message.team == self.team:
            self.believes(message.coordinator_epoch)

    def on_grant(self, message):
        own = (message.agent, message.incarnation) == (self.agent, self.incarnation)
        if not own or (message.team and message.team != self.team):
            return
        if message.coordinator_epoch < self.epoch or not self.believes(message.coordinator_epoch):
            return
        if message.request_id != self.request.request_id:
            return
        if message.status == OptionGrant.CANCELLED:
            self.ask()
        elif self.state == AgentStatus.RUNNING:
            self.beat_at = time.monotonic()
        elif message.status == OptionGrant.REFUSED and message.coordinator_epoch > self.request.coordinator_epoch:
            self.say_at = time.monotonic()
        elif message.status == OptionGrant.REFUSED:
            self.ask()
            self.say_at = time.monotonic() + REPEAT_S
        elif message.option < OPTIONS and 0.0 < message.deadline < float("inf"):
            self.state, self.grant, self.began = AgentStatus.RUNNING, message, time.monotonic()
            self.beat_at = self.began

    def tick(self):
        now = time.monotonic()
        if self.state == AgentStatus.RUNNING and now - self.began > self.grant.deadline:
            self.ask()
            self.state = AgentStatus.FALLBACK
        elif self.state == AgentStatus.RUNNING and now - self.began > LASTS_S:
            self.ask(1.0, 1)
        elif self.state == AgentStatus.WAITING and now - self.asked > PATIENCE_S:
            self.state = AgentStatus.FALLBACK
        if self.state != AgentStatus.RUNNING and now >= self.say_at:
            self.say_at = now + REPEAT_S
            self.request.coordinator_epoch = self.epoch
            self.requests.publish(self.request)
        if now >= self.beat_at:
            self.beat_at = now + HEARTBEAT_S
            self.beat(now)

    def beat(self, now):
        running = self.state == AgentStatus.RUNNING
        out = AgentStatus(
            agent=self.agent,
            incarnation=self.incarnation,
            state=self.state,
            coordinator_epoch=self.grant.coordinator_epoch if running else self.epoch,
            request_id=self.request.request_id,
            grant_id=self.grant.grant_id if self.grant else 0,
            option=self.grant.option if self.grant else 0,
            elapsed=now - self.began if running else 0.0,
            team=self.team,
        )
        out.header.stamp = self.get_clock().now().to_msg()
        self.statuses.publish(out)


if __name__ == "__main__":
    rclpy.init(args=sys.argv)
    rclpy.spin(PlainRobot(*sys.argv[1:3]))
