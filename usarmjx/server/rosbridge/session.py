"""A client's dialogue in the rosbridge protocol: JSON in, requests and JSON out; it knows no socket."""

import json
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import BridgeFrame, Compression, fragments

MAX_UNFINISHED = 16
"""Most messages of one client of which fragments are missing; the oldest goes for a new one."""
MAX_LENGTH = 256 * 1024
"""Longest message that is put together [characters]."""
MAX_FRAGMENTS = 4096
"""Most fragments that a message may have."""


@dataclass
class UnfinishedMessage:
    """A message of which fragments are missing.

    Attributes:
        total: How many fragments it has.
        parts: Those that have come, by number.
        length: Of all of them [characters].
    """

    total: int
    parts: dict[int, str] = field(default_factory=dict[int, str])
    length: int = 0


class Defragmenter:
    """Puts the messages of one client together."""

    def __init__(self) -> None:
        self._unfinished: dict[str, UnfinishedMessage] = {}

    def add(self, said: RosMessage) -> str | None:
        """Take a fragment; return the whole message if it was the last one that was missing.

        Raises:
            UsageError: It is none, or the message becomes too long; its other fragments are forgotten.
        """
        name, data, number, total = _checked(said)
        one = self._of(name, total)
        one.length += len(data) - len(one.parts.get(number, ""))
        one.parts[number] = data
        if one.length > MAX_LENGTH:
            del self._unfinished[name]
            raise UsageError(f"{clip(name)} is longer than {MAX_LENGTH} characters")
        if len(one.parts) < total:
            return None
        del self._unfinished[name]
        return "".join(one.parts[number] for number in range(total))

    def _of(self, name: str, total: int) -> UnfinishedMessage:
        one = self._unfinished.get(name)
        if one is None or one.total != total:
            self._unfinished.pop(name, None)
            while len(self._unfinished) >= MAX_UNFINISHED:
                self._unfinished.pop(next(iter(self._unfinished)))
            one = self._unfinished[name] = UnfinishedMessage(total)
        return one


def _checked(said: RosMessage) -> tuple[str, str, int, int]:
    """Return id, data, number and count of a fragment.

    Raises:
        UsageError: They are not what they should be.
    """
    name, data, number, total = (said.get(key) for key in ("id", "data", "num", "total"))
    if not (isinstance(name, str) and isinstance(data, str)):
        raise UsageError("a fragment has id and data, texts")
    if type(number) is not int or type(total) is not int or not 0 <= number < total <= MAX_FRAGMENTS:
        raise UsageError(f"a fragment has total, from 1 to {MAX_FRAGMENTS}, and num, from 0 to total - 1")
    return name, data, number, total


MAX_SUBSCRIPTIONS = 512
MAX_QUEUE = 64
"""Most messages of one topic that wait for a client; the oldest goes for a new one."""
MAX_REPLIES = 256
"""Most answers and status messages that wait for a client; the oldest goes for a new one."""
SHORTEST_FRAGMENT = 100
"""Nobody may have messages cut into smaller pieces [characters]."""
LEVELS = ("error", "warning", "info", "none")


class Published(NamedTuple):
    """A message that a client sends to a topic."""

    topic: str
    message: object


class ServiceCall(NamedTuple):
    """A service that a client calls; `answer` is told the values, or what was wrong."""

    service: str
    args: Mapping[str, Any]
    answer: Callable[[RosMessage | str], None]


BridgeRequest: TypeAlias = Published | ServiceCall


class SubscriptionRequest(NamedTuple):
    """What one of a client's subscriptions to a topic asks for.

    Attributes:
        pause: Least time between two messages [s].
        length: Of the queue.
        fragment_size: Longest piece of a text [characters]; 0: whole messages.
        compression: How messages travel.
    """

    pause: float = 0.0
    length: int = 0
    fragment_size: int = 0
    compression: Compression = Compression.NONE


@dataclass
class TopicSubscription:
    """What a client wants of a topic.

    Attributes:
        type: Its type as short as possible; empty: whatever it is.
        version: Whose names it is told in.
        wishes: What is asked for, by the client's ids; the latest says how messages travel.
        told: What `RosTopic.news` was when it was told last; None: never.
        due: When it may be told next [s].
        waiting: Messages that have not been sent yet.
        sent: How many have been cut into fragments.
    """

    type: str
    version: RosVersion
    wishes: dict[str, SubscriptionRequest] = field(default_factory=dict[str, SubscriptionRequest])
    told: Hashable = None
    due: float = 0.0
    waiting: deque[BridgeFrame] = field(default_factory=deque[BridgeFrame])
    sent: int = 0

    @property
    def compression(self) -> Compression:
        """How its messages travel."""
        return list(self.wishes.values())[-1].compression if self.wishes else Compression.NONE

    def put(self, text: BridgeFrame, news: Hashable, now: float) -> None:
        """Let a message wait for being sent, in the place of the oldest if there are too many."""
        self.told = news
        self.due = now + min(wish.pause for wish in self.wishes.values())
        room = max(1, max(wish.length for wish in self.wishes.values()))
        while len(self.waiting) >= min(room, MAX_QUEUE):
            self.waiting.popleft()
        self.waiting.append(text)

    def next_frames(self, topic: str) -> Iterator[BridgeFrame]:
        """Return what goes over the websocket for the message that has waited longest."""
        whole = self.waiting.popleft()
        size = min((wish.fragment_size for wish in self.wishes.values() if wish.fragment_size), default=0)
        if isinstance(whole, bytes) or not size:
            return iter((whole,))
        self.sent += 1
        return fragments(whole, size, f"{topic}:{self.sent}")


class BridgeSession:
    """One client's dialogue.

    Args:
        version: Whose names it speaks, unless it names a type as the other does.
        type_of: Returns the type of a topic in short; None: there is no such topic.

    Attributes:
        subscriptions: What it wants, by topics.
    """

    def __init__(self, version: RosVersion, type_of: Callable[[str], str | None]) -> None:
        self._version, self._type_of = version, type_of
        self.subscriptions: dict[str, TopicSubscription] = {}
        self._replies: deque[str] = deque(maxlen=MAX_REPLIES)
        self._frames: Iterator[BridgeFrame] = iter(())
        self._advertised: set[str] = set()
        self._level = LEVELS.index("info")
        self._handlers: dict[str, Callable[[RosMessage], BridgeRequest | None]] = {
            "advertise": self._advertise,
            "unadvertise": self._unadvertise,
            "publish": self._publish,
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "call_service": self._call,
            "set_level": self._set_level,
            "fragment": self._put_together,
        }
        self._fragments = Defragmenter()

    def receive(self, text: str | bytes) -> BridgeRequest | None:
        """Take a message; return what the world is to do about it, if anything."""
        said: RosMessage = {}
        try:
            said = _read(text)
            handler = self._handlers.get(str(said.get("op")))
            if handler is None:
                known = ", ".join(self._handlers)
                raise UsageError(f"no such op as {clip(str(said.get('op')))}; known: {known}")
            return handler(said)
        except UsageError as error:
            self.status("error", str(error), said.get("id"))
            return None

    def status(self, level: str, text: str, about: object = None) -> None:
        """Tell the client what was wrong, or how it goes, unless it wants no such messages."""
        if LEVELS.index(level) <= self._level and self._level < LEVELS.index("none"):
            self._reply({"op": "status", "level": level, "msg": text}, about)

    def wanted(self, now: float) -> Iterator[tuple[str, TopicSubscription]]:
        """Yield topics that may be told at a time [s]."""
        return ((name, one) for name, one in self.subscriptions.items() if now >= one.due - 1e-6)

    def take(self) -> BridgeFrame | None:
        """Return what is to be sent next: answers first, then topics in turn; None: nothing is."""
        if (frame := next(self._frames, None)) is not None:
            return frame
        if self._replies:
            return self._replies.popleft()
        for name, one in self.subscriptions.items():
            if one.waiting:
                # To the end of the line: every topic has its turn.
                self.subscriptions[name] = self.subscriptions.pop(name)
                self._frames = one.next_frames(name)
                return next(self._frames)
        return None

    def _reply(self, message: RosMessage, about: object) -> None:
        named = {} if about is None else {"id": about}
        self._replies.append(json.dumps({**message, **named}))

    def _check_type(self, topic: str, asked: str) -> str:
        """Return a type in short.

        Raises:
            UsageError: The topic has another one.
        """
        short, there = asked.replace("/msg/", "/"), self._type_of(topic)
        if asked and there is not None and short != there:
            raise UsageError(f"{topic} is of type {there}, not {clip(asked)}")
        return short

    def _advertise(self, said: RosMessage) -> None:
        topic = _text(said, "topic")
        if self._type_of(topic) is None:
            raise UsageError(f"nobody here listens to {clip(topic)}")
        self._check_type(topic, _text(said, "type"))
        self._advertised.add(topic)

    def _unadvertise(self, said: RosMessage) -> None:
        topic = _text(said, "topic")
        if topic not in self._advertised:
            self.status("warning", f"{clip(topic)} was not advertised", said.get("id"))
        self._advertised.discard(topic)

    def _publish(self, said: RosMessage) -> Published:
        return Published(_text(said, "topic"), said.get("msg", {}))

    def _subscribe(self, said: RosMessage) -> None:
        topic, asked = _text(said, "topic"), _text(said, "type", "")
        wish = _wish(said)
        short = self._check_type(topic, asked)
        if not short and self._type_of(topic) is None:
            raise UsageError(f"there is no topic {clip(topic)} yet: name its type to wait for it")
        one = self.subscriptions.get(topic)
        if one is None:
            if len(self.subscriptions) >= MAX_SUBSCRIPTIONS:
                raise UsageError(f"more than {MAX_SUBSCRIPTIONS} topics are too many for one client")
            version = RosVersion.ROS2 if "/msg/" in asked else self._version
            one = self.subscriptions[topic] = TopicSubscription(short, version)
        name = str(said.get("id", ""))
        one.wishes.pop(name, None)
        one.wishes[name] = wish
        if len(one.wishes) > MAX_SUBSCRIPTIONS:
            one.wishes.pop(next(iter(one.wishes)))

    def _unsubscribe(self, said: RosMessage) -> None:
        topic = _text(said, "topic")
        one = self.subscriptions.get(topic)
        if one is None:
            self.status("warning", f"{clip(topic)} was not subscribed", said.get("id"))
            return
        one.wishes.pop(str(said.get("id", "")), None)
        if "id" not in said or not one.wishes:
            del self.subscriptions[topic]

    def _call(self, said: RosMessage) -> ServiceCall:
        service, args = _text(said, "service"), said.get("args", {})
        about = said.get("id")

        def answer(values: RosMessage | str) -> None:
            done = not isinstance(values, str)
            message = {"op": "service_response", "service": service, "values": values, "result": done}
            self._reply(message, about)

        return ServiceCall(service, args if isinstance(args, dict) else {}, answer)

    def _put_together(self, said: RosMessage) -> BridgeRequest | None:
        whole = self._fragments.add(said)
        if whole is None:
            return None
        if _read(whole).get("op") == "fragment":
            raise UsageError("fragments of fragments are too much")
        return self.receive(whole)

    def _set_level(self, said: RosMessage) -> None:
        level = _text(said, "level")
        if level not in LEVELS:
            raise UsageError(f"no level {clip(level)}; there is: {', '.join(LEVELS)}")
        self._level = LEVELS.index(level)


def _read(text: str | bytes) -> RosMessage:
    try:
        said = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"that is no JSON: {error}") from error
    if not isinstance(said, dict):
        raise UsageError("a message is a JSON object with op")
    return said


def _wish(said: RosMessage) -> SubscriptionRequest:
    """Return what a subscription asks for.

    Raises:
        UsageError: It asks for something that there is not.
    """
    compression = _text(said, "compression", "none")
    if compression not in set(Compression):
        raise UsageError(f"no compression {clip(compression)}; there is: {', '.join(Compression)}")
    size = 0 if said.get("fragment_size") is None else int(_number(said, "fragment_size"))
    if 0 < size < SHORTEST_FRAGMENT:
        raise UsageError(f"fragment_size is {size}, expected 0 or at least {SHORTEST_FRAGMENT}")
    pause, length = _number(said, "throttle_rate") / 1000, int(_number(said, "queue_length"))
    return SubscriptionRequest(pause, length, size, Compression(compression))


def _text(said: RosMessage, key: str, default: str | None = None) -> str:
    value = said.get(key, default)
    if not isinstance(value, str):
        raise UsageError(f"{said['op']} needs {key}, a text")
    return value


def _number(said: RosMessage, key: str) -> float:
    value = said.get(key, 0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e9:
        raise UsageError(f"{key} is {clip(str(value))}, expected a number from 0 on")
    return float(value)
