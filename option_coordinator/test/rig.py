"""Coordinators and robots in separate processes, with a record of all their messages."""

import contextlib
import itertools
import multiprocessing
import os
import runpy
import signal
import sys
import time
from collections import defaultdict
from importlib import import_module
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from option_coordinator.nodes.messages import EXCHANGE, grant_of, request_message, request_of, status_message
from option_coordinator.protocol.protocol_types import AgentState, GrantStatus, MessageError
from policies import random_tensors
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from ctrl_rl_msgs.msg import AgentStatus, JointOptionStep, OptionGrant, OptionRequest
from option_coordinator import Agent, OptionPolicy, Request, Status

COORDINATOR = "option_coordinator.nodes.coordinator_node"
ROBOT = str(Path(__file__).with_name("robot_process.py"))
FORKS = multiprocessing.get_context("forkserver")
"""Server that forks processes with the imports already done."""
FORKS.set_forkserver_preload([COORDINATOR, "option_coordinator.nodes.option_agent"])
PATIENCE = 120.0  # s of wall time, for a busy machine
LEASE, LOST_AFTER = 0.5, 1.0
STANDS_BY = "another coordinator decides"
_NUMBERS = itertools.count()


def write_policy(path, seed=0, robots=2, names=()):
    """Write a policy of robots r0, r1, ... with three options each and random weights far from uniform."""
    agents = tuple(Agent(name, ("stay", "go", "look"), 2) for name in names or [f"r{i}" for i in range(robots)])
    tensors = random_tensors("mixture", (3,) * robots, 2 * robots, np.random.default_rng(seed), 0.1)
    policy = OptionPolicy(agents, "mixture", False, tensors)
    policy.save(path)
    return OptionPolicy.load(path).digest


def run(program, arguments, environment):
    """Run a module's `main`, or a script, in its own process."""
    os.environ.update(environment)
    sys.argv = [program, *arguments]
    if program.endswith(".py"):
        runpy.run_path(program, run_name="__main__")
    else:
        sys.exit(import_module(program).main())


class Rig:
    """Namespace with its own processes; shutting ROS down ends the rig's node."""

    def __init__(self, folder):
        self.namespace = f"/rig{next(_NUMBERS)}"
        self.policy = folder / "policy.safetensors"
        self.digest = write_policy(self.policy)
        self.processes, self.log_level = {}, "error"
        self.node = rclpy.create_node("watcher", namespace=self.namespace)
        self.requests, self.grants, self.statuses, self.steps, self.diagnostics = [], [], [], [], []
        self._listen(OptionRequest, "option_requests", self._on_request)
        self._given = defaultdict(dict)
        self._listen(OptionGrant, "option_grants", self._on_grant)
        self._listen(AgentStatus, "agent_status", self.statuses.append)
        self._listen(JointOptionStep, "joint_option_step", self.steps.append)
        self._listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self.request_publisher = self.node.create_publisher(OptionRequest, "option_requests", EXCHANGE)
        self.status_publisher = self.node.create_publisher(AgentStatus, "agent_status", EXCHANGE)
        self.grant_publisher = self.node.create_publisher(OptionGrant, "option_grants", EXCHANGE)

    def _listen(self, kind, topic, take, qos=EXCHANGE):
        self.node.create_subscription(kind, topic, take, qos)

    def _on_request(self, message):
        with contextlib.suppress(MessageError):  # tests send such ones
            self.requests.append(request_of(message))

    def _on_diagnostics(self, message):
        if message.status[0].hardware_id == self.namespace:  # one topic for all namespaces
            self.diagnostics.append(message)

    def _on_grant(self, message):
        with contextlib.suppress(MessageError):
            grant = grant_of(message)
            self.grants.append(grant)
            key = (grant.coordinator_epoch, grant.incarnation, grant.request_id)
            self._given[grant.agent, grant.status].setdefault(key, grant)

    def start(self, name, program, *arguments, **parameters):
        settings = [part for key, value in parameters.items() for part in ("-p", f"{key}:={value}")]
        names = ["-r", f"__ns:={self.namespace}", "-r", f"__node:={name}"]
        words = [*arguments, "--ros-args", *names, *settings, "--log-level", self.log_level]
        process = FORKS.Process(target=run, args=(program, words, dict(os.environ)), daemon=True)
        process.start()
        self.processes[name] = process

    def coordinator(self, *names, **parameters):
        """Start coordinators with short timeouts; return once they are heard, so that no early message is missed."""
        said = len(self.diagnostics)
        times = {"lease": LEASE, "lost_after": LOST_AFTER, "repeat": 0.05, "policy_limit": 10.0, "stale": 30.0}
        own = names or ("coordinator",)
        for name in own:
            self.start(name, COORDINATOR, **({"policy": self.policy, "longest_option": 600.0} | times | parameters))
        for name in own:
            self.until(lambda name=name: self.status(name, said), f"the coordinator '{name}'")

    def robot(self, name, node=None, **parameters):
        self.start(node or name, ROBOT, robot=name, **parameters)

    def signal(self, name, number):
        os.kill(self.processes[name].pid, number)
        if number == signal.SIGKILL:
            self.processes[name].join()

    def kill(self, name):
        self.signal(name, signal.SIGKILL)
        del self.processes[name]

    def until(self, condition, what):
        """Return the value of `condition` once it is true, regardless of the time it takes."""
        deadline = time.monotonic() + PATIENCE
        while not (found := condition()):
            rclpy.spin_once(self.node, timeout_sec=0.02)
            for name, process in self.processes.items():
                assert process.is_alive(), f"{name} ended with {process.exitcode}"
            assert time.monotonic() < deadline, f"not within {PATIENCE:g} s: {what}\n{self.summary()}"
        return found

    def summary(self):
        """Latest state of every participant, for diagnosing a test without progress."""
        last = {s.agent: s for s in self.statuses} | {d.status[0].name: d.status[0] for d in self.diagnostics}
        return "\n".join(str(word) for word in [*last.values(), *self.requests[-1:], *self.grants[-1:]])

    def let_pass(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def given(self, agent, status=GrantStatus.GRANTED):
        """Distinct answers of one kind to one robot, in order."""
        return list(self._given[agent, status].values())

    def granted(self, agent, count=1):
        given = self._given[agent, GrantStatus.GRANTED]
        self.until(lambda: len(given) >= count, f"{count} grants for {agent}")
        return self.given(agent)[-1]

    def says(self, agent, state):
        """Latest status of a robot if it reports the given state, else None."""
        last = next((s for s in reversed(self.statuses) if s.agent == agent), None)
        return last if last is not None and last.state == state else None

    def running(self, agent):
        """Latest status of a robot that reports a running option."""
        return self.says(agent, AgentState.RUNNING)

    def new_step(self, condition, what):
        """Return the next joint step for which `condition` holds."""
        seen = len(self.steps)
        return self.until(lambda: next((s for s in self.steps[seen:] if condition(s)), None), what)

    def status(self, name, said=0):
        """Latest diagnostics of a node, or None; the first `said` messages are skipped."""
        found = (m.status[0] for m in reversed(self.diagnostics[said:]))
        return next((s for s in found if s.name == f"{self.namespace}/{name}"), None)

    def counted(self, kind, name="coordinator"):
        """Number of times a node's diagnostics report an event."""
        status = self.status(name)
        return 0 if status is None else int({v.key: v.value for v in status.values}.get(kind, 0))

    def deciding(self, *names):
        """Coordinator that decides according to its latest diagnostics; None unless there is exactly one."""
        said = [status for name in names if (status := self.status(name)) is not None]
        found = [s.name.rsplit("/", 1)[-1] for s in said if s.message != STANDS_BY and "listening" not in s.message]
        return found[0] if len(found) == 1 and len(said) == len(names) else None

    def ask(self, agent="r0", request_id=1, incarnation=1, epoch=0, **changes):
        """Send a single request."""
        now = 1e-9 * self.node.get_clock().now().nanoseconds
        fields = {"observation": np.zeros(2, np.float32), "legal": np.ones(3, bool), "stamp": now} | changes
        request = Request(
            agent=agent, request_id=request_id, incarnation=incarnation, coordinator_epoch=epoch, **fields
        )
        self.request_publisher.publish(request_message(request))

    def say(self, state, agent="r0", incarnation=1, **told):
        """Send a single heartbeat."""
        self.status_publisher.publish(status_message(Status(agent, incarnation, state, **told), 0.0))

    def answer(self, condition, what, **request):
        """Send requests until an answer satisfies `condition`."""
        seen = len(self.grants)

        def answered():
            self.ask(**request)
            self.let_pass(0.05)
            return next((g for g in self.grants[seen:] if g.agent == request.get("agent", "r0") and condition(g)), None)

        return self.until(answered, what)

    def set_parameter(self, name, value):
        """Return the coordinator's reply to a parameter change."""
        client = self.node.create_client(SetParameters, "coordinator/set_parameters")
        self.until(client.service_is_ready, "the coordinator's parameters")
        parameter = Parameter(name, value=value).to_parameter_msg()
        future = client.call_async(SetParameters.Request(parameters=[parameter]))
        self.until(future.done, "an answer to another parameter")
        self.node.destroy_client(client)
        return future.result().results[0]

    def close(self):
        for process in self.processes.values():
            process.kill()
            process.join()
