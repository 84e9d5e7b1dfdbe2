"""Parameters of the coordinator node."""

from ctrl_rl_core import Parameter

PARAMETERS = (
    Parameter(
        "team",
        "",
        "Team that comes with the package, or its .yaml file; empty for the robots of the policy.",
        kind="path",
    ),
    Parameter(
        "team_name",
        "",
        "Name of the team in all messages, which keeps teams in one namespace apart; empty for the team file's name, "
        "or one made from the policy's robots.",
    ),
    Parameter(
        "policy",
        "spread",
        "Learned policy's name or file; 'spread': least travel and queueing time; 'uniform': any legal option.",
        live=True,
        kind="path",
    ),
    Parameter(
        "work",
        "",
        "SQLite file of tasks that arrive by the services ~/submit_work, ~/change_work and ~/query_work, and that are "
        "assigned in place of a policy; for a team with 'deliveries: 0'. Empty for a team with a fixed number.",
        kind="path",
    ),
    Parameter("policy_digest", "", "SHA-256 (hex) that a policy file must have from now on; empty for any.", live=True),
    Parameter(
        "batch_window",
        0.0,
        "Time for which the first pending request waits for others [s]; 0 to decide at once.",
        0.0,
        1.0,
    ),
    Parameter(
        "lease", 0.5, "Silence after which a robot is suspect, or another coordinator takes over [s].", 0.05, 60.0
    ),
    Parameter("lost_after", 2.0, "Silence after which a robot is lost [s].", 0.05, 600.0),
    Parameter("repeat", 0.1, "Time between repetitions of an unacknowledged grant [s].", 0.01, 10.0),
    Parameter("stale", 2.0, "Age at which an observation is refused [s].", 0.05, 600.0),
    Parameter(
        "policy_limit", 0.05, "Time limit of the policy, after which safe options are granted [s].", 0.00001, 10.0
    ),
    Parameter("longest_option", 60.0, "Maximum duration of an option, if no team file gives it [s].", 0.01, 86400.0),
    Parameter(
        "most_overruns",
        3,
        "Number of times in a row that a robot may exceed an option's maximum duration before it is not granted that "
        "option again, until its node restarts; 0 for no limit.",
        0,
        1000000,
    ),
    Parameter(
        "memory",
        "",
        "SQLite file that keeps what the robots carry and have delivered; empty for the file of 'work', or to keep it "
        "in memory only.",
        kind="path",
    ),
    Parameter("safe_option", 0, "Index of the safe option, if no team file gives it.", 0, 10000),
    Parameter("step_length", 1.0, "Duration of a low-level step, if no team file gives it [s].", 0.001, 3600.0),
    Parameter("discount", 0.99, "Discount factor gamma of a low-level step, if no team file gives it.", 0.001, 1.0),
    Parameter("seed", 0, "Seed of the policy's draws.", minimum=0),
)
