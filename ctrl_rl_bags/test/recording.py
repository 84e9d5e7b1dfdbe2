"""Start and stop of recorders in separate processes."""

import signal


def record(start, folder, *parameters, program=("-m", "ctrl_rl_bags.recording.recorder_node")):
    arguments = [item for parameter in (f"output:={folder}", *parameters) for item in ("-p", parameter)]
    return start(*program, "--ros-args", *arguments)


def stop(process, number=signal.SIGINT, limit=30):
    process.send_signal(number)
    output, errors = process.communicate(timeout=limit)
    return process.returncode, output, errors
