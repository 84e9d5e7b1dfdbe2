"""Test robot as a process: real agent and real topics; its options only take time."""

import math
import sys
from pathlib import Path
from typing import ClassVar

import numpy as np
from ctrl_rl_core.ros import ok
from option_coordinator.nodes.option_agent import STEADY, Clocks

from ctrl_rl_core import Parameter, SuiteNode, run_node
from option_coordinator import AgentObservation, ClientTimeouts, OptionAgent, OptionResult


class TestRobot(SuiteNode):
    """Robot with options of `lasts` seconds each; 0.0 means endless."""

    PARAMETERS: ClassVar = (
        Parameter("robot", "r0", "Name."),
        Parameter("lasts", 0.2, "How long each option lasts [s]."),
        Parameter("patience", 1.0, "Until it falls back [s]."),
        Parameter("team", "", "Name of its team."),
        Parameter("memory", "", "File that keeps it, besides the coordinator.", kind="path"),
        Parameter("keeps", False, "Whether the number of its finished options outlives its process."),
        Parameter("broken", "", "What its observation is.", choices=("", "number", "size")),
    )

    def __init__(self):
        super().__init__("robot")
        self.running, self.done = None, 0
        self.ends = math.inf
        self.clocks = Clocks(self)
        timeouts = ClientTimeouts(heartbeat=0.05, repeat=0.05, waiting=self.settings["patience"])
        name, team = self.settings["robot"], self.settings["team"]
        memory = Path(self.settings["memory"]) if self.settings["memory"] else None
        options = ("stay", "go", "look")
        self.agent = OptionAgent(self, name, options, self, timeouts=timeouts, team=team, memory=memory)
        self.create_timer(0.005, self.work, clock=STEADY)
        self.agent.start()

    def now(self):
        return self.clocks().task

    def observe(self):
        broken = {"": np.zeros(2), "number": np.array((0.0, math.nan)), "size": np.zeros(3)}
        work = f"done={self.done}" if self.settings["keeps"] else ""
        return AgentObservation(broken[self.settings["broken"]], np.ones(3, bool), work)

    def resume(self, work):
        self.done = int(work.removeprefix("done="))

    def begin(self, option):
        if self.running is not None:
            sys.exit("two options at once")
        self.running = option
        self.ends = self.now() + (self.settings["lasts"] or math.inf)

    def leave(self):
        self.running = None
        return OptionResult(1.0, 1)

    def work(self):
        if self.running is not None and self.now() >= self.ends:
            self.running = None
            self.done += self.agent.option is not None
            self.agent.ended(1.0, 1)

    def status(self):
        return ok("works", **self.agent.client.counts)


if __name__ == "__main__":
    sys.exit(run_node(TestRobot))
