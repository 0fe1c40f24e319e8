"""isaac-net's uplink of robots that move about: queues, radio and medium access, slot by slot."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import torch
from clock import measure, read_options
from isaac_net import Requests, make_engine

PERIOD = 0.1
"""Time of a step [s]: 40 uplink slots."""
SIDE, PACE = 150.0, 0.3
"""Side of the square in which robots are, and how far they move in a step [m], as in its README."""
SENDING = 0.3
"""Share of the robots that send a frame in a step."""


def main():
    """Measure it."""
    options = read_options()
    device = torch.device("cuda" if options.device == "gpu" else "cpu")
    torch.manual_seed(options.seed)
    shape = (options.worlds, options.robots)
    backend = "triton" if options.device == "gpu" else "reference"
    net = make_engine("L2-legacy", *shape, device, backend=backend)

    def run(position):
        for _ in range(options.steps):
            send = (torch.rand(shape, device=device) < SENDING).long()
            net.submit(None, Requests(send))
            net.step(None, position)
            position = (position + PACE * torch.randn_like(position)).clamp(0.0, SIDE)
        if device.type == "cuda":
            torch.cuda.synchronize()
        return position

    name = torch.cuda.get_device_name() if device.type == "cuda" else "cpu"
    start = SIDE * torch.rand((*shape, 2), device=device)
    measure(run, start, options, PERIOD, ("isaac-net", "torch"), name, backend=backend)


if __name__ == "__main__":
    main()
