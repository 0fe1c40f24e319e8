"""usarmjx: USARSim rebuilt as a GPU-batched simulator of multi-robot swarms."""

from usarmjx import threads

threads.guard()
