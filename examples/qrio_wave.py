"""Let a QRIO, Sony's humanoid, wave its right arm while it stands.

    python -m usarmjx serve --arena yellow &
    python examples/qrio_wave.py --port 3000 --waves 3

Each report of the server is answered with the next position of the arm (MULTIDRIVE); the joints go there
at their own speed. Times are the server's.
"""

import argparse
import math
import sys

try:
    from usarmjx.client import UsarsimClient
except ImportError:  # without usarmjx: its usarsim_client.py lies beside this file
    from usarsim_client import UsarsimClient

RAISED = {"RightShoulderPitch": 2.6, "RightElbow": 0.5}  # rad: the arm up and a little before the head
SIDE = "RightShoulderRoll"  # turns the raised arm outward
MIDDLE, SWING = 0.45, 0.4  # rad
PERIOD = 1.2  # s a wave
RAISE = 1.0  # s for the arm to go up, and to come down again


def gesture(seconds: float, waves: int) -> dict[str, float]:
    """Return the positions of the arm's joints, so long after the start [rad]."""
    waving = 0.0 <= seconds - RAISE <= waves * PERIOD
    up = seconds < RAISE + waves * PERIOD
    sway = SWING * math.sin(2 * math.pi * (seconds - RAISE) / PERIOD) if waving else 0.0
    return {**{name: angle * up for name, angle in RAISED.items()}, SIDE: MIDDLE * up + sway}


def wave(robot: UsarsimClient, waves: int) -> float:
    """Wave so many times and put the arm down; return the largest lean of the body [rad]."""
    began, now, lean = -1.0, -1.0, 0.0
    while began < 0 or now - began < 2 * RAISE + waves * PERIOD:
        message = robot.receive(robot.timeout)
        if message is None:
            raise TimeoutError(f"no data for {robot.timeout:g} s")
        if message.kind == "STA":
            now = message.time() or 0.0
            began = now if began < 0 else began
            robot.multidrive(gesture(now - began, waves))
        elif message.value("Type") == "GroundTruth":
            roll, pitch, _ = (math.remainder(angle, 2 * math.pi) for angle in message.vector("Orientation"))
            lean = max(lean, abs(roll), abs(pitch))
    return lean


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Let a QRIO wave.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=3000)
    parser.add_argument("--waves", type=int, default=3)
    options = parser.parse_args()
    try:
        with UsarsimClient(options.host, options.port, timeout=60.0) as robot:
            _, place, turn = robot.start_poses()[0]
            robot.init("USARBot.QRIO", "Waver", place, turn)
            lean = wave(robot, options.waves)
    except OSError as error:
        print(f"qrio_wave: {options.host}:{options.port}: {error}", file=sys.stderr)
        return 1
    print(f"waved {options.waves} times, leaning by {math.degrees(lean):.1f} degrees at most")
    return 0


if __name__ == "__main__":
    sys.exit(main())
