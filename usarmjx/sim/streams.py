"""Streams of random numbers: the first fold of a world's key, by what the numbers are for."""

from enum import IntEnum


class Stream(IntEnum):
    """What a world draws random numbers for; see `world.episode_key`. A number that changes changes runs."""

    SENSOR_START = 0
    SENSOR_NOISE = 1
    START_POSES = 2
    RADIO = 3
    MAIL = 4
    TASK_START = 5
    TASK_STEP = 6
    RANDOMIZATION = 7
