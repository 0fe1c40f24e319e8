"""A pad to drive with: arrows for fingers and the mouse, and keys while it has the focus.

Viser tells of buttons that are held down, ten times a second, and of nothing else that lasts. So each
direction is one of its buttons, out of sight; what is seen is HTML of ours, which holds them down.
"""

import html
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial

import viser

HOLD_RATE = 10.0
"""So often the page tells that a button is held down [Hz]."""
FORGET = 0.35
"""A direction of which nothing is heard for so long is held no more [s]."""
DIRECTIONS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "ahead": ("\u25b2", ("ArrowUp", "KeyW"), "1 / 2"),
    "left": ("\u25c0", ("ArrowLeft", "KeyA"), "2 / 1"),
    "right": ("\u25b6", ("ArrowRight", "KeyD"), "2 / 3"),
    "back": ("\u25bc", ("ArrowDown", "KeyS"), "2 / 2"),
    "up": ("\u21e7", ("KeyR",), "1 / 4"),
    "down": ("\u21e9", ("KeyF",), "2 / 4"),
}
"""Sign, keys and place in the grid of each direction."""
CLIMBING = ("up", "down")
POINTER = 4242
"""Number of the pointer that holds the buttons down: no real one's."""


class DrivePad:
    """The pad of one person; elements go where the present container of its GUI is.

    Args:
        gui: That person's GUI.
        steer: Is told how far ahead, to the left and up to go [-1, 1] again and again while anything is held,
            and 0, 0, 0 once nothing is; called in viser's thread.
        climbs: Whether there is an up and a down.
    """

    def __init__(
        self, gui: viser.GuiApi, steer: Callable[[float, float, float], None], *, climbs: bool = False
    ) -> None:
        self._steer = steer
        self._held: dict[str, float] = {}
        names = [name for name in DIRECTIONS if climbs or name not in CLIMBING]
        buttons = {name: gui.add_button(f"drive {name}") for name in names}
        for name, button in buttons.items():
            self._listen(name, button)
        # Viser's buttons have no other name in the page.
        gui.add_html(pad_html({name: button._impl.uuid for name, button in buttons.items()}))

    def _listen(self, name: str, button: viser.GuiButtonHandle) -> None:
        # Asynchronous ones are called in order.
        async def hold(event: object) -> None:
            del event
            self.hold(name, time.monotonic())

        async def release(event: object) -> None:
            del event
            self.release(name, time.monotonic())

        button.on_hold(hold, callback_hz=HOLD_RATE)
        button.on_click(release)

    def hold(self, name: str, now: float) -> None:
        """A direction is held down at a time [s]."""
        self._held[name] = now
        self._tell(now)

    def release(self, name: str, now: float) -> None:
        """A direction is no longer held."""
        if self._held.pop(name, None) is not None:
            self._tell(now)

    def _tell(self, now: float) -> None:
        self._held = {name: since for name, since in self._held.items() if now - since < FORGET}
        held = self._held.keys()
        self._steer(
            float(("ahead" in held) - ("back" in held)),
            float(("left" in held) - ("right" in held)),
            float(("up" in held) - ("down" in held)),
        )


def pad_html(buttons: Mapping[str, str]) -> str:
    """Return the pad.

    Args:
        buttons: The ids of viser's buttons in the page, by direction.
    """
    keys = {code: buttons[name] for name in buttons for code in DIRECTIONS[name][1]}
    hide = ",".join(f'div:has(> [id="{button}"])' for button in buttons.values())
    arrows = "".join(map(partial(_arrow, buttons), buttons))
    letters = "W A S D" + (", R and F for up and down" if "up" in buttons else "")
    on_key = f"const k={_object(keys)}[event.code];if(k){{event.preventDefault();event.stopPropagation();"
    leave = f"for(const k of {_list(buttons.values())}){_release('k')}"
    return (
        f"<style>{hide}{{display:none}}"
        f".drivepad{{grid-template-columns:repeat({4 if 'up' in buttons else 3},3.2em)}}"
        ".drivepad{display:grid;grid-auto-rows:3.2em;gap:.3em;"
        "justify-content:center;padding:.4em;margin:0 .6em .5em;border-radius:.5em;outline:1px solid #8888;"
        "touch-action:none;user-select:none;-webkit-user-select:none}"
        ".drivepad:focus{outline:2px solid #4a90e2}"
        ".drivepad button{font-size:1.4em;border:0;border-radius:.4em;background:#8883;color:inherit;"
        "touch-action:none}.drivepad button:active{background:#4a90e2}"
        ".drivepad small{grid-column:1 / -1;align-self:center;text-align:center;opacity:.7}</style>"
        f'<div class="drivepad" tabindex="0" aria-label="drive" '
        f'onkeydown="{_quoted(on_key + "if(!event.repeat)" + _press("k") + "}")}" '
        f'onkeyup="{_quoted(on_key + _release("k") + "}")}" '
        f'onblur="{_quoted(leave)}">'
        f"{arrows}<small>Hold an arrow; or click here and hold arrow keys or {letters}.</small></div>"
    )


def _arrow(buttons: Mapping[str, str], name: str) -> str:
    sign, _, place = DIRECTIONS[name]
    button = repr(buttons[name])
    press = (
        "event.preventDefault();this.parentNode.focus();this.setPointerCapture(event.pointerId);"
        + _press(button)
    )
    release = _quoted(_release(button))
    return (
        f'<button tabindex="-1" aria-label="{name}" style="grid-area:{place}" '
        f'onpointerdown="{_quoted(press)}" onpointerup="{release}" onpointercancel="{release}" '
        f'oncontextmenu="event.preventDefault()">{sign}</button>'
    )


def _press(button: str) -> str:
    """Return the script that holds a button down."""
    return f"document.getElementById({button})?.dispatchEvent({_pointer('pointerdown')});"


def _release(button: str) -> str:
    """Return the script that lets a button go: the click says so to the server."""
    return (
        f"{{const b=document.getElementById({button});"
        f"if(b){{b.dispatchEvent({_pointer('pointerup')});b.click();}}}}"
    )


def _pointer(kind: str) -> str:
    return f"new PointerEvent('{kind}',{{bubbles:true,button:0,pointerId:{POINTER}}})"


def _object(pairs: Mapping[str, str]) -> str:
    return "({" + ",".join(f"{key}:{value!r}" for key, value in pairs.items()) + "})"


def _list(values: Iterable[str]) -> str:
    return repr(list(values))


def _quoted(script: str) -> str:
    return html.escape(script, quote=True)
