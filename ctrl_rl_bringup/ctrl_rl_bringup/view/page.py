"""The page in the browser: the drawn scene, its texts, and the panel that a visitor with the token gets."""

from __future__ import annotations

import html
import logging
import math
import socket
import sys
import time
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from io import StringIO
from typing import Any

import viser

from ctrl_rl_bringup.view.access import Access
from ctrl_rl_bringup.view.colours import DANGER, RAW, WARNING
from ctrl_rl_bringup.view.drawing import Drawing
from ctrl_rl_bringup.view.scene import Note, Scene
from ctrl_rl_core import CtrlRlError, Robot

_TEXT_S = 0.3
"""Shortest time between two texts [s]: a phone has to lay each out."""
_MOST_REQUESTS = 32
_FARTHEST, _LAST = 1e6, 1e9
_COLOURS = ("inherit", *(f"rgb{each}" for each in (WARNING, DANGER, RAW)))
"""Colours of texts by level."""


@dataclass(frozen=True)
class SendGoal:
    """A visitor's goal in the frame of the map [m]."""

    x: float
    y: float


@dataclass(frozen=True)
class StopRobot:
    """A visitor stops the robot."""


@dataclass(frozen=True)
class ReleaseStop:
    """A visitor lifts the emergency stop again."""


@dataclass(frozen=True)
class UsePolicy:
    """A visitor chooses a policy by name."""

    name: str


Request = SendGoal | StopRobot | ReleaseStop | UsePolicy


class PageError(CtrlRlError):
    """Nothing can listen on the page's address."""


class _Server(viser.ViserServer):
    """A server that no visitor can open to the internet: viser's own takes that as a message from anybody."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002
        return None


class Page:
    """Serves the page, and collects what its visitors ask for.

    Whatever a visitor can touch belongs to this visitor's own connection; shared parts are texts and shapes. So nobody
    reads another's token, and messages about another's buttons reach nothing.

    Args:
        host: Address to listen on.
        port: First port to try; the next free one is taken.
        robot: Robot to draw.
        access: Who may move the robot; None if there is none to move.
        policies: Names of policies to choose from.

    Attributes:
        frames: Number of frames drawn.

    Raises:
        PageError: This machine has no such address.
    """

    def __init__(
        self, host: str, port: int, robot: Robot, access: Access | None = None, policies: Sequence[str] = ()
    ) -> None:
        self._access, self._policies = access, tuple(policies)
        self._requests: deque[Request] = deque(maxlen=_MOST_REQUESTS)
        self.frames = 0
        self._text, self._text_at = "", -math.inf
        _check_host(host)
        for name in ("websockets.server", "asyncio"):  # a visitor may be gone at any time, or send nonsense
            logging.getLogger(name).setLevel(logging.CRITICAL)
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
        with redirect_stdout(StringIO()):  # viser draws a box about its address
            self._server = _Server(host=host, port=port, label=robot.name, verbose=False)
        self._server.gui.configure_theme(show_share_button=False, show_logo=False)
        self._server.gui.main_panel.dock_right()
        self._drawing = Drawing(self._server, robot)
        self._html = self._server.gui.add_html("", order=_LAST)  # texts grow, and the button Stop must not move
        if access is not None:
            self._server.on_client_connect(self._greet)

    @property
    def address(self) -> str:
        """Address for a browser."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def take_requests(self) -> list[Request]:
        """Return what visitors with the token have asked for since the last call, in order."""
        return [self._requests.popleft() for _ in range(len(self._requests))]

    def draw(self, scene: Scene) -> None:
        """Show a scene; parts that have not changed cost nothing."""
        with self._server.atomic():
            self._drawing.update(scene)
        now = time.monotonic()
        if now - self._text_at >= _TEXT_S:
            text = _as_html(scene)
            if text != self._text:
                self._html.content = self._text = text
            self._text_at = now
        self.frames += 1

    def add_timeline(
        self, duration: float, on_play: Callable[[bool], None], on_seek: Callable[[float], None]
    ) -> Callable[[float, bool], None]:
        """Add a time line, which every visitor may use, and return the function that moves it.

        Args:
            duration: Length of the recording [s].
            on_play: Called with whether to play.
            on_seek: Called with a time since the start [s].
        """
        gui = self._server.gui
        play = gui.add_checkbox("play", True)
        line = gui.add_slider("time [s]", 0.0, max(round(duration, 1), 0.1), 0.1, 0.0)

        @play.on_update
        def _(event: Any) -> None:
            if event.client_id is not None:
                on_play(bool(play.value))

        @line.on_update
        def _(event: Any) -> None:
            if event.client_id is not None and math.isfinite(line.value):
                on_seek(min(max(float(line.value), 0.0), duration))

        def move(seconds: float, playing: bool) -> None:
            line.value, play.value = round(seconds, 1), playing

        return move

    def close(self) -> None:
        """End the server."""
        with redirect_stdout(StringIO()):  # viser says so, too
            self._server.stop()

    def _greet(self, client: viser.ClientHandle) -> None:
        """Give a new visitor the field for the token."""
        gui = client.gui
        with gui.add_folder("Move the robot") as folder:
            field = gui.add_text("token", "")
            unlock = gui.add_button("Unlock")
            answer = gui.add_markdown("You see the robot; the token lets you move it.")

        @unlock.on_click
        def _(_event: Any) -> None:
            assert self._access is not None
            if reason := self._access.check(str(field.value)):
                answer.content = f"{reason[0].upper()}{reason[1:]}."
                return
            folder.remove()
            self._unlock(client)

    def _unlock(self, client: viser.ClientHandle) -> None:
        """Give a visitor with the token the buttons that move the robot."""
        gui = client.gui
        stop = gui.add_button("Stop", color=DANGER)
        stop.on_click(lambda _event: self._requests.append(StopRobot()))
        with gui.add_folder("Goal"):
            clicks = gui.add_checkbox("click on the floor", True)
            place = gui.add_vector2("x, y [m]", (0.0, 0.0), step=0.1)
            gui.add_button("Go").on_click(lambda _event: self._send_goal(*place.value))
        with gui.add_folder("More", expand_by_default=False):
            gui.add_button("Release emergency stop").on_click(lambda _event: self._requests.append(ReleaseStop()))
            if self._policies:
                choice = gui.add_dropdown("policy", self._policies)
                gui.add_button("Use policy").on_click(lambda _event: self._use_policy(str(choice.value)))
        client.scene.on_click()(partial(self._on_click, clicks, place))

    def _on_click(self, clicks: Any, place: Any, event: viser.SceneClickEvent) -> None:
        """Send the point of the floor under a click as the goal."""
        x, y, z = event.ray_origin
        along_x, along_y, down = event.ray_direction
        if clicks.value and z * down < 0.0:
            goal = x - z * along_x / down, y - z * along_y / down
            place.value = round(goal[0], 2), round(goal[1], 2)
            self._send_goal(*goal)

    def _send_goal(self, x: float, y: float) -> None:
        if abs(x) <= _FARTHEST and abs(y) <= _FARTHEST:
            self._requests.append(SendGoal(float(x), float(y)))

    def _use_policy(self, name: str) -> None:
        if name in self._policies:
            self._requests.append(UsePolicy(name))


def _check_host(host: str) -> None:
    """Raise if nothing can listen on an address: viser would try for ever."""
    try:
        socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        raise PageError(f"--host {host[:100]}: {error.strerror or error}") from None


def announce(page: Page, access: Access | None, given: bool) -> None:
    """Print where the page is, and the token unless the user gave it.

    Args:
        page: The page.
        access: Who may move the robot; None if there is none to move.
        given: Whether the user gave the token.
    """
    sys.stdout.write(f"view: {page.address}\n")
    if access is not None and not given:
        sys.stdout.write(f"view: token {access.token}\n")
    sys.stdout.flush()


def _as_html(scene: Scene) -> str:
    """Return the texts of a scene; whatever others have sent is escaped."""
    lines = []
    if scene.pose is not None:
        x, y, yaw = scene.pose
        lines.append(f"<b>pose</b> {x:.2f} m, {y:.2f} m, {math.degrees(yaw):.0f}&deg;")
    for name, command in (("raw", scene.raw), ("sent", scene.sent)):
        if command is not None:
            lines.append(f"<b>{name}</b> {command[0]:.2f} m/s, {command[1]:.2f} rad/s")
    notes = sorted(dict(scene.notes).items(), key=lambda item: -item[1].level)
    lines += [_line(name, note) for name, note in notes]
    return f'<div style="font-size:0.8em;padding:0 0.8em;overflow-wrap:anywhere">{"<br>".join(lines)}</div>'


def _line(name: str, note: Note) -> str:
    colour = _COLOURS[min(max(note.level, 0), len(_COLOURS) - 1)]
    return f'<span style="color:{colour}"><b>{html.escape(name)}</b> {html.escape(note.text)}</span>'
