"""The rosbridge port of a served world: websockets, and the publication of its topics."""

import asyncio
import logging
import socket
import time
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from typing import Annotated, NamedTuple, TypeAlias

from websockets.asyncio.server import Server, ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.base.settings import AT_LEAST_ONE, validate
from usarmjx.server.gamebots.budget import INIT_COST, ClientBudget
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.network.access import EVERYBODY, AccessRules
from usarmjx.server.network.gate import Gate
from usarmjx.server.network.loop_meter import preferred
from usarmjx.server.network.ports import PORT, bound_socket
from usarmjx.server.network.web_gate import FROM_ELSEWHERE, is_own_name, listen_for_websockets
from usarmjx.server.pictures.views import RenderThread
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import BridgeFrame, Compression, publication
from usarmjx.server.rosbridge.republisher import (
    ARRAY_TYPE,
    FEEDBACK,
    FEEDBACK_TYPE,
    LISTENED,
    REPUBLISH,
    TransformRequests,
    feedback,
    transform_array,
)
from usarmjx.server.rosbridge.services import REMOVE, SPAWN, RosApi, RosRobots, read_spawn
from usarmjx.server.rosbridge.session import BridgeSession, Published, ServiceCall, TopicSubscription
from usarmjx.server.rosbridge.topics import (
    PictureRequest,
    RosTopic,
    WorldTopics,
    image_view,
    picture_messages,
)
from usarmjx.server.runtime.logs import FaultLog
from usarmjx.server.worlds.served_world import ServedWorld

log = logging.getLogger(__name__)

MAX_MESSAGE_SIZE = 256 * 1024
"""Longest message of a client [bytes]."""
MESSAGES_PER_STEP = 32
"""Messages of a client after which it waits for the next control step: no client may delay the world."""
REPUBLISHED = "/tf_repub/"
"""Start of the names of topics with transforms that clients asked for."""
IMAGE_PERIOD = 0.1
"""Least interval between two pictures of a topic [s]."""

PublicationKey: TypeAlias = tuple[str, RosVersion, Compression]
"""Key of a publication that several clients share: topic, version and encoding."""


@dataclass(frozen=True)
class RosSettings:
    """Settings of the rosbridge server.

    Attributes:
        host: Address to bind.
        port: TCP port; 0 picks a free one.
        version: Version for clients that name none.
        size: Width and height of pictures [pixels].
        max_connections: Most clients at once.
        access: Rules of access.
        names: Names of this server for browsers, and origins of pages that may connect, beside localhost and
            its IP addresses.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, PORT] = 9090
    version: RosVersion = RosVersion.ROS2
    size: Annotated[tuple[int, int], AT_LEAST_ONE] = (320, 240)
    max_connections: Annotated[int, AT_LEAST_ONE] = 16
    access: AccessRules = EVERYBODY
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)


@dataclass(eq=False)
class RosClient:
    """A client's connection.

    Attributes:
        socket: Its websocket.
        session: Its dialogue.
        robots: Its robots.
        transforms: The transforms that it asked for.
        wake: Set when there may be something to send.
    """

    socket: ServerConnection
    session: BridgeSession
    robots: RosRobots
    transforms: TransformRequests = field(default_factory=TransformRequests)
    wake: asyncio.Event = field(default_factory=asyncio.Event)

    def check_is_here(self) -> None:
        """Check that the connection is open.

        Raises:
            PeerError: It is not.
        """
        if self.socket.state is not State.OPEN:
            raise PeerError("it has left before its robot came")

    async def send(self) -> None:
        """Send waiting frames, for ever; a slow reader loses older messages and delays no other client."""
        while True:
            frame = self.session.take()
            if frame is None:
                self.wake.clear()
                await self.wake.wait()
            else:
                await self.socket.send(frame)


class PictureSubscription(NamedTuple):
    """A picture that a client waits for."""

    client: RosClient
    subscription: TopicSubscription
    topic: RosTopic
    revision: Hashable


class RosbridgeServer:
    """The rosbridge server of one world; a `gamebots.server.Service`.

    Args:
        world: The served world.
        settings: Settings of the server.
        bound: A socket that is bound to the port already.

    Attributes:
        port: The port in use, once started.
        server: The world's server, which spawned robots report to; set it before the start.
    """

    def __init__(self, world: ServedWorld, settings: RosSettings, bound: socket.socket | None = None) -> None:
        self._world, self._settings, self._bound = world, settings, bound
        self.port = settings.port
        self.server: BotServer | None = None
        self._topics = WorldTopics(world, settings.size)
        self._services = RosApi(self._topics, settings.version, lambda: world.time)
        self._clients: list[RosClient] = []
        self._republished = 0
        self._gate = Gate(settings.access, settings.max_connections, "rosbridge")
        self._render_thread = RenderThread(world)
        self._stepped = asyncio.Event()
        self._fault_log = FaultLog(log)
        self._listener: Server | None = None

    async def start(self) -> list[str]:
        """Listen; return lines for the user.

        Raises:
            UsageError: The port is taken or the address is not ours.
        """
        host = self._settings.host
        bound = self._bound or bound_socket(host, self._settings.port)
        self.port = bound.getsockname()[1]
        names = {host, *self._settings.names}
        self._listener = await listen_for_websockets(
            self._accept, bound, names, self._gate, self._answer, MAX_MESSAGE_SIZE
        )
        return [f"rosbridge at ws://{host}:{self.port}/{'?token=...' if self._settings.access.token else ''}"]

    def tick(self) -> None:
        """Publish new messages to subscribers."""
        # Set and cleared at once: all that wait now go on, and later ones wait for the next step.
        self._stepped.set()
        self._stepped.clear()
        made: dict[PublicationKey, BridgeFrame] = {}
        pictures: list[PictureSubscription] = []
        topics = self._topics.all() if self._clients else {}
        for client in self._clients:
            # Before new commands: a robot that is gone, or taken over, must not follow its trajectory on.
            client.robots.forget_lost()
            client.robots.tick()
            for name, subscription in client.session.due_topics(self._world.time):
                topic = topics.get(name)
                revision = topic.revision() if topic and subscription.type in ("", topic.type) else None
                if topic is None or revision is None or revision == subscription.last_revision:
                    continue
                if topic.make is None:
                    pictures.append(PictureSubscription(client, subscription, topic, revision))
                elif frame := self._publication(topic, subscription, made):
                    subscription.put(frame, revision, self._world.time)
                    client.wake.set()
        self._tell_transforms()
        if pictures and self._render_thread.is_ready(time.monotonic()):
            self._render_thread.begin(self._show(pictures))
        self._fault_log.flush()

    def stop(self) -> None:
        """Close all connections."""
        if self._listener is not None:
            self._listener.close()
        self._render_thread.close()

    def _publication(
        self, topic: RosTopic, subscription: TopicSubscription, made: dict[PublicationKey, BridgeFrame]
    ) -> BridgeFrame:
        """Return a topic's frame, made once for all clients; empty if the message cannot be made."""
        version, how = subscription.version, subscription.compression
        key = topic.name, version, how
        if key not in made and topic.make is not None:
            # Kept if making fails, too: the other subscribers of this step do not try again.
            made[key] = ""
            try:
                message = topic.make(version)
                made[key] = publication(topic.name, topic.type, message, version, how, self._world.time)
            except Exception as error:  # a sensor may be a user's own, with any error in its reading
                self._fault_log.warning("%s is not published: %s", topic.name, error)
        return made[key]

    def _tell_transforms(self) -> None:
        """Publish the transforms that clients asked for, those that are due."""
        now, known = self._world.time, dict[RosVersion, list[RosMessage]]()
        for client in self._clients:
            requests = client.transforms
            wanted = [(FEEDBACK, one) for one in requests.goals.values()]
            wanted += [(name, one) for name, one in requests.topics.items()]
            for topic, request in wanted:
                subscription = client.session.subscriptions.get(topic)
                # Times are sums of floats: without the margin a message slips to the next step now and then.
                if subscription is None or now < request.due - 1e-6:
                    continue
                version, how = subscription.version, subscription.compression
                if version not in known:
                    known[version] = self._topics.transforms(version)
                array = transform_array(version, now, known[version], request)
                kind = ARRAY_TYPE
                if topic == FEEDBACK:
                    kind, array = FEEDBACK_TYPE, feedback(version, now, request.name, array)
                frame = publication(topic, kind, array, version, how, now)
                # A client's goals share this topic: none may push the message of another out of the queue.
                sources = len(requests.goals) if topic == FEEDBACK else 1
                subscription.put(frame, (request.name, now), now, sources)
                request.due = now + request.pause
                client.wake.set()

    async def _show(self, subscriptions: Sequence[PictureSubscription]) -> None:
        now, size = self._world.time, self._settings.size
        views = {one.topic: image_view(one.topic, size) for one in subscriptions}
        asked = [
            PictureRequest(one.topic, one.subscription.version, one.subscription.compression)
            for one in subscriptions
        ]
        make = partial(picture_messages, asked, views, now)
        for one in subscriptions:
            # Before rendering: a tick in the meantime must not order the same picture again.
            one.subscription.last_revision, one.subscription.due = one.revision, now + IMAGE_PERIOD
        # Rendering takes longer than a control step: the loop steps on meanwhile.
        frames = await self._render_thread.render(views.values(), make)
        for one, frame in zip(subscriptions, frames, strict=True):
            # The client may have unsubscribed during the rendering.
            if one.subscription.requests:
                one.subscription.put(frame, one.revision, now)
                one.subscription.due = max(one.subscription.due, now + IMAGE_PERIOD)
                one.client.wake.set()

    def _type_of(self, topic: str) -> str | None:
        found = self._topics.all().get(topic)
        if found is None and topic.startswith(REPUBLISHED):
            return ARRAY_TYPE
        return found.type if found else (LISTENED | {FEEDBACK: FEEDBACK_TYPE}).get(topic)

    async def _accept(self, connection: ServerConnection) -> None:
        peer = "rosbridge {}:{}".format(*connection.remote_address[:2])
        if len(self._clients) >= self._settings.max_connections or self.server is None:
            # As one without a handshake: it need not answer for seconds, and there may be thousands.
            self._gate.add_stranger(connection.transport)
            # 1013 asks the client to try again later.
            await connection.close(1013, f"{len(self._clients)} clients are connected already")
            return
        session = BridgeSession(self._settings.version, self._type_of)
        client = RosClient(connection, session, RosRobots(self.server, peer))
        self._clients.append(client)
        log.info("%s: connected", peer)
        sender = asyncio.create_task(client.send())
        try:
            with preferred(connection.transport.get_extra_info("socket").fileno()):
                await self._listen(client)
        except ConnectionClosed:
            pass
        except PeerError as error:
            self._fault_log.warning("%s: %s", peer, error)
        finally:
            # Cancelled first: nothing may be sent while the client's robots leave.
            sender.cancel()
            self._clients.remove(client)
            # A robot of another client that it drove would otherwise drive on for ever.
            client.robots.stop_driven()
            client.robots.dismiss()
            log.info("%s: disconnected", peer)

    async def _listen(self, client: RosClient) -> None:
        assert self.server is not None
        count, budget = 0, ClientBudget(self.server.budgets)
        async for text in client.socket:
            spawn = None
            async with budget:  # a client that has spent its budget is not read
                request = client.session.receive(text)
                if isinstance(request, Published):
                    self._execute(client, request)
                elif isinstance(request, ServiceCall) and request.service == SPAWN:
                    spawn = request
                elif isinstance(request, ServiceCall):
                    self._serve(client, request)
            if spawn is not None:  # waits for others: a turn is work without waiting
                budget.charge(INIT_COST)
                await self._serve_spawn(client, spawn)
            client.wake.set()
            count += 1
            if count % MESSAGES_PER_STEP == 0:
                await self._stepped.wait()

    def _execute(self, client: RosClient, said: Published) -> None:
        topic = self._topics.all().get(said.topic)
        try:
            if said.topic in LISTENED:
                client.transforms.take(said.topic, said.message)
                return
            if topic is None or topic.robot is None or topic.camera >= 0:
                raise UsageError(f"nobody here listens to {said.topic[:80]}")
            client.robots.command(topic.robot, topic.type, said.message)
        except UsageError as error:
            client.session.status("error", str(error))

    async def _serve_spawn(self, client: RosClient, call: ServiceCall) -> None:
        try:
            call.answer({"name": await self._spawn(client, call)})
        except UsageError as error:
            call.answer(str(error))

    def _serve(self, client: RosClient, call: ServiceCall) -> None:
        try:
            if call.service == REMOVE:
                client.robots.remove(str(call.args.get("name", "")))
                call.answer({})
            elif call.service == REPUBLISH:
                # Counted for all clients together: no two of them get the same topic.
                self._republished += 1
                name = f"{REPUBLISHED}{self._republished}"
                client.transforms.add_topic(name, call.args)
                call.answer({"topic_name": name})
            else:
                call.answer(self._services.call(call.service, call.args))
        except UsageError as error:
            call.answer(str(error))

    async def _spawn(self, client: RosClient, call: ServiceCall) -> str:
        """Spawn a robot in its turn; return its name in topics and frames."""
        init, spec = read_spawn(call.args)
        if self.server is None:
            raise UsageError("the server has not begun")
        await self.server.prepare(spec)
        robot = await self.server.join(partial(client.robots.spawn, init, spec), client.check_is_here)
        return self._topics.name_of(robot)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return None to begin a websocket: for pages from known names, and for clients that are no page."""
        names = {self._settings.host, *self._settings.names}
        origins = [origin.partition("://")[2] for origin in request.headers.get_all("Origin")]
        # Browsers send Origin always, programs do not: only pages are checked.
        if not all(is_own_name(origin, names) for origin in origins):
            return connection.respond(HTTPStatus.FORBIDDEN, FROM_ELSEWHERE)
        if "websocket" not in ",".join(request.headers.get_all("Upgrade")).lower():
            return connection.respond(HTTPStatus.UPGRADE_REQUIRED, "this is for rosbridge, over websockets\n")
        return None
