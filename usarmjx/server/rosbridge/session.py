"""A client's dialogue in the rosbridge protocol: JSON in, requests and JSON out; it knows no socket."""

import json
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import ALSO_TAKEN, RosMessage, RosVersion, json_object
from usarmjx.server.rosbridge.encodings import BridgeFrame, Compression, fragments

MAX_UNFINISHED = 16
"""Most incomplete messages of one client; the oldest is dropped for a new one."""
MAX_LENGTH = 256 * 1024
"""Longest message of fragments [characters]."""
MAX_FRAGMENTS = 4096
"""Most fragments of a message."""
MAX_SUBSCRIPTIONS = 512
"""Most topics of one client, and most subscriptions to one topic."""
MAX_QUEUE = 64
"""Most messages of one topic that wait for a client; the oldest is dropped for a new one."""
MAX_REPLIES = 256
"""Most answers and status messages that wait for a client; the oldest is dropped for a new one."""
SHORTEST_FRAGMENT = 100
"""Smallest fragment size that a client may ask for [characters]."""
LEVELS = ("error", "warning", "info", "none")
"""Levels of status messages, the most severe first; "none" disables them."""


@dataclass
class UnfinishedMessage:
    """A message with missing fragments.

    Attributes:
        total: Number of its fragments.
        parts: Received fragments, by number.
        length: Length of all received fragments [characters].
    """

    total: int
    parts: dict[int, str] = field(default_factory=dict[int, str])
    length: int = 0


class Defragmenter:
    """Reassembles the messages of one client from fragments."""

    def __init__(self) -> None:
        self._unfinished: dict[str, UnfinishedMessage] = {}

    def add(self, message: RosMessage) -> str | None:
        """Take a fragment; return the whole message if it was the last missing one.

        Raises:
            UsageError: It is none, or the message becomes too long; its other fragments are dropped.
        """
        name, data, number, total = _checked(message)
        one = self._of(name, total)
        # A fragment that comes twice replaces the first, and must not count double.
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
        # The same id with another count is a new message: clients reuse ids after a reconnect.
        if one is None or one.total != total:
            self._unfinished.pop(name, None)
            while len(self._unfinished) >= MAX_UNFINISHED:
                self._unfinished.pop(next(iter(self._unfinished)))
            one = self._unfinished[name] = UnfinishedMessage(total)
        return one


def _checked(message: RosMessage) -> tuple[str, str, int, int]:
    """Return id, data, number and count of a fragment.

    Raises:
        UsageError: A field is missing or not valid.
    """
    name, data, number, total = (message.get(key) for key in ("id", "data", "num", "total"))
    if not (isinstance(name, str) and isinstance(data, str)):
        raise UsageError("a fragment has id and data, texts")
    # Exact types: a bool is an int for isinstance.
    if type(number) is not int or type(total) is not int or not 0 <= number < total <= MAX_FRAGMENTS:
        raise UsageError(f"a fragment has total, from 1 to {MAX_FRAGMENTS}, and num, from 0 to total - 1")
    return name, data, number, total


class Published(NamedTuple):
    """A message that a client sends to a topic."""

    topic: str
    message: object


class ServiceCall(NamedTuple):
    """A call of a service; `answer` takes the values, or the reason of a failure."""

    service: str
    args: Mapping[str, Any]
    answer: Callable[[RosMessage | str], None]


BridgeRequest: TypeAlias = Published | ServiceCall


class SubscriptionRequest(NamedTuple):
    """Options of one of a client's subscriptions to a topic.

    Attributes:
        pause: Least time between two messages [s].
        length: Length of the queue.
        fragment_size: Longest fragment of a text [characters]; 0: whole messages.
        compression: Encoding of messages.
    """

    pause: float = 0.0
    length: int = 0
    fragment_size: int = 0
    compression: Compression = Compression.NONE


@dataclass
class TopicSubscription:
    """A client's subscriptions to one topic, and its waiting messages.

    Attributes:
        type: Its short type; empty: any.
        version: Version of its field names.
        requests: Options, by the client's ids; the latest decides the encoding.
        last_revision: `RosTopic.revision` of the last message; None without one.
        due: Earliest time of the next message [s].
        waiting: Messages that have not been sent yet.
        sent: Number of messages that were cut into fragments.
    """

    type: str
    version: RosVersion
    requests: dict[str, SubscriptionRequest] = field(default_factory=dict[str, SubscriptionRequest])
    last_revision: Hashable = None
    due: float = 0.0
    waiting: deque[BridgeFrame] = field(default_factory=deque[BridgeFrame])
    sent: int = 0

    @property
    def compression(self) -> Compression:
        """Encoding of its messages."""
        return list(self.requests.values())[-1].compression if self.requests else Compression.NONE

    def put(self, text: BridgeFrame, revision: Hashable, now: float, sources: int = 1) -> None:
        """Queue a message, and drop the oldest ones beyond the queue's length.

        Args:
            text: The message.
            revision: Value that changes with it.
            now: Simulated time [s].
            sources: Number of sources on the topic, none of which takes the room of another.
        """
        self.last_revision = revision
        self.due = now + min(request.pause for request in self.requests.values())
        # At least one message: with a queue of 0 rosbridge means the latest, not none.
        room = max(sources, max(request.length for request in self.requests.values()))
        while len(self.waiting) >= min(room, MAX_QUEUE):
            self.waiting.popleft()
        self.waiting.append(text)

    def next_frames(self, topic: str) -> Iterator[BridgeFrame]:
        """Return the frames of the message that has waited longest."""
        whole = self.waiting.popleft()
        sizes = [request.fragment_size for request in self.requests.values() if request.fragment_size]
        size = min(sizes, default=0)
        # Fragments are JSON, which holds no bytes.
        if isinstance(whole, bytes) or not size:
            return iter((whole,))
        self.sent += 1
        return fragments(whole, size, f"{topic}:{self.sent}")


class BridgeSession:
    """One client's dialogue.

    Args:
        version: Version of its names, unless it names a type in the other's form.
        type_of: Returns the short type of a topic; None: there is no such topic.

    Attributes:
        subscriptions: Its subscriptions, by topics.
    """

    def __init__(self, version: RosVersion, type_of: Callable[[str], str | None]) -> None:
        self._version, self._type_of = version, type_of
        self.subscriptions: dict[str, TopicSubscription] = {}
        # A deque with a bound drops at its other end by itself.
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
        """Take a message; return the request to the world, if any."""
        # Before the try: an error in reading has no id to answer with.
        message: RosMessage = {}
        try:
            message = _read(text)
            handler = self._handlers.get(str(message.get("op")))
            if handler is None:
                known = ", ".join(self._handlers)
                raise UsageError(f"no such op as {clip(str(message.get('op')))}; known: {known}")
            return handler(message)
        except UsageError as error:
            self.status("error", str(error), message.get("id"))
            return None

    def status(self, level: str, text: str, about: object = None) -> None:
        """Queue a status message for the client, unless its level excludes it."""
        # "none" is the last level, and by its index alone would let every message through.
        if LEVELS.index(level) <= self._level and self._level < LEVELS.index("none"):
            self._reply({"op": "status", "level": level, "msg": text}, about)

    def due_topics(self, now: float) -> Iterator[tuple[str, TopicSubscription]]:
        """Yield the topics whose next message may be sent at a time [s]."""
        # Times are sums of periods, with rounding errors.
        return ((name, one) for name, one in self.subscriptions.items() if now >= one.due - 1e-6)

    def take(self) -> BridgeFrame | None:
        """Return the next frame to send: answers first, then topics in turn; None without one."""
        # Fragments of one message are finished first: clients reassemble by id, but many expect no others
        # between.
        if (frame := next(self._frames, None)) is not None:
            return frame
        if self._replies:
            return self._replies.popleft()
        for name, one in self.subscriptions.items():
            if one.waiting:
                # Reinsertion moves the topic to the end of the dict: every topic has its turn.
                self.subscriptions[name] = self.subscriptions.pop(name)
                self._frames = one.next_frames(name)
                return next(self._frames)
        return None

    def _reply(self, message: RosMessage, about: object) -> None:
        named = {} if about is None else {"id": about}
        self._replies.append(json.dumps({**message, **named}))

    def _check_type(self, topic: str, asked: str) -> str:
        """Return a short type.

        Raises:
            UsageError: The topic has another one.
        """
        short, there = asked.replace("/msg/", "/"), self._type_of(topic)
        if asked and there is not None and short != there:
            raise UsageError(f"{topic} is of type {there}, not {clip(asked)}")
        return short

    def _advertise(self, message: RosMessage) -> None:
        topic = _text(message, "topic")
        if self._type_of(topic) is None:
            raise UsageError(f"nobody here listens to {clip(topic)}")
        asked = _text(message, "type")
        self._check_type(topic, ALSO_TAKEN.get(asked.replace("/msg/", "/"), asked))
        # Any number of topics of tf2_web_republisher are listened to: a client could fill the memory.
        if topic not in self._advertised and len(self._advertised) >= MAX_SUBSCRIPTIONS:
            raise UsageError(f"more than {MAX_SUBSCRIPTIONS} topics are too many for one client")
        self._advertised.add(topic)

    def _unadvertise(self, message: RosMessage) -> None:
        topic = _text(message, "topic")
        if topic not in self._advertised:
            self.status("warning", f"{clip(topic)} was not advertised", message.get("id"))
        self._advertised.discard(topic)

    def _publish(self, message: RosMessage) -> Published:
        return Published(_text(message, "topic"), message.get("msg", {}))

    def _subscribe(self, message: RosMessage) -> None:
        topic, asked = _text(message, "topic"), _text(message, "type", "")
        request = _request(message)
        short = self._check_type(topic, asked)
        if not short and self._type_of(topic) is None:
            raise UsageError(f"there is no topic {clip(topic)} yet: name its type to wait for it")
        one = self.subscriptions.get(topic)
        if one is None:
            if len(self.subscriptions) >= MAX_SUBSCRIPTIONS:
                raise UsageError(f"more than {MAX_SUBSCRIPTIONS} topics are too many for one client")
            # Only ROS 2 spells types with /msg/.
            version = RosVersion.ROS2 if "/msg/" in asked else self._version
            one = self.subscriptions[topic] = TopicSubscription(short, version)
        name = str(message.get("id", ""))
        # Taken out first, so that a repeated id moves to the end, where the latest encoding is.
        one.requests.pop(name, None)
        one.requests[name] = request
        if len(one.requests) > MAX_SUBSCRIPTIONS:
            one.requests.pop(next(iter(one.requests)))

    def _unsubscribe(self, message: RosMessage) -> None:
        topic = _text(message, "topic")
        one = self.subscriptions.get(topic)
        if one is None:
            self.status("warning", f"{clip(topic)} was not subscribed", message.get("id"))
            return
        one.requests.pop(str(message.get("id", "")), None)
        # Without an id all subscriptions to the topic end, as in rosbridge.
        if "id" not in message or not one.requests:
            del self.subscriptions[topic]

    def _call(self, message: RosMessage) -> ServiceCall:
        service, args = _text(message, "service"), message.get("args", {})
        about = message.get("id")

        def answer(values: RosMessage | str) -> None:
            done = not isinstance(values, str)
            message = {"op": "service_response", "service": service, "values": values, "result": done}
            self._reply(message, about)

        return ServiceCall(service, args if isinstance(args, dict) else {}, answer)

    def _put_together(self, message: RosMessage) -> BridgeRequest | None:
        whole = self._fragments.add(message)
        if whole is None:
            return None
        # Otherwise nested fragments could call this function to any depth.
        if _read(whole).get("op") == "fragment":
            raise UsageError("fragments of fragments are too much")
        return self.receive(whole)

    def _set_level(self, message: RosMessage) -> None:
        level = _text(message, "level")
        if level not in LEVELS:
            raise UsageError(f"no level {clip(level)}; known: {', '.join(LEVELS)}")
        self._level = LEVELS.index(level)


def _read(text: str | bytes) -> RosMessage:
    try:
        message = json_object(json.loads(text))
    # The text is a client's: some thousand nested brackets exhaust Python's stack.
    except (ValueError, RecursionError) as error:
        raise UsageError(f"that is no JSON: {error}") from error
    if message is None:
        raise UsageError("a message is a JSON object with op")
    return message


def _request(message: RosMessage) -> SubscriptionRequest:
    """Return the options of a subscription.

    Raises:
        UsageError: An option is not valid.
    """
    compression = _text(message, "compression", "none")
    if compression not in set(Compression):
        raise UsageError(f"no compression {clip(compression)}; known: {', '.join(Compression)}")
    size = 0 if message.get("fragment_size") is None else int(_number(message, "fragment_size"))
    if 0 < size < SHORTEST_FRAGMENT:
        raise UsageError(f"fragment_size is {size}, expected 0 or at least {SHORTEST_FRAGMENT}")
    # throttle_rate is in milliseconds.
    pause, length = _number(message, "throttle_rate") / 1000, int(_number(message, "queue_length"))
    return SubscriptionRequest(pause, length, size, Compression(compression))


def _text(message: RosMessage, key: str, default: str | None = None) -> str:
    value = message.get(key, default)
    if not isinstance(value, str):
        raise UsageError(f"{message['op']} needs {key}, a text")
    return value


def _number(message: RosMessage, key: str) -> float:
    value = message.get(key, 0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e9:
        raise UsageError(f"{key} is {clip(str(value))}, expected a number from 0 on")
    return float(value)
