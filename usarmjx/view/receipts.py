"""Receipts of a user's browser: it has taken all that it was sent."""

from collections.abc import Callable

import viser

PIXEL = "data:image/gif;base64,R0lGODlhAQABAIAAAAAAAP///yH5BAEAAAAALAAAAAABAAEAAAIBRAA7"
"""A picture of one transparent pixel."""
PRESS_PERIOD = 300
"""Interval at which a page presses the button of a receipt [ms]."""


def element_id(button: viser.GuiButtonHandle) -> str:
    """Return the id of a button in the page."""
    return str(button._impl.uuid)  # pyright: ignore[reportPrivateUsage, reportUnknownMemberType]


def hidden_style(*buttons: str) -> str:
    """Return the style that hides buttons which scripts press, by their ids."""
    return ",".join(f'div:has(> [id="{button}"])' for button in buttons) + "{display:none}"


def receipt_html(button: str) -> str:
    """Return an invisible picture that presses a button, by its id, until that is gone.

    Viser's page sends one message in 50 ms, and only the last of those that wait: a single press may be lost.
    """
    press = (
        f"{{const press=()=>{{const b=document.getElementById('{button}');"
        f"if(b){{b.click();setTimeout(press,{PRESS_PERIOD})}}}};press()}}"
    )
    return f'<style>{hidden_style(button)}</style><img hidden alt="" src="{PIXEL}" onload="{press}">'


def when_taken(
    client: viser.ClientHandle, post: Callable[[Callable[[], None]], None], act: Callable[[], None]
) -> None:
    """Run an action once a user's browser has taken all that it was sent before.

    A browser that is slow, or behind another window, takes messages late.

    Args:
        client: Client of the user; no container of its GUI is open.
        post: Queues an action for the thread of the caller.
        act: The action; it runs once, or never if the user leaves.
    """
    parts: list[viser.GuiButtonHandle | viser.GuiHtmlHandle] = []

    def done() -> None:
        if parts:  # a panel that is folded and unfolded shows the picture again
            for part in parts:
                part.remove()
            parts.clear()
            act()

    with client.atomic():  # the button is never seen without its style
        button = client.gui.add_button("taken")
        button.on_click(lambda _: post(done))
        parts += [button, client.gui.add_html(receipt_html(element_id(button)))]
