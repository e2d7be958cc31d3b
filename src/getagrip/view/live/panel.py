"""The controls of the page and the pictures beside the scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.view.live import words
from getagrip.view.live.column import TRUTH, Column
from getagrip.view.live.evidence import Numbers
from getagrip.view.live.player import SPEEDS
from getagrip.view.live.plots import COLOURS, Curve, Plot, legend
from getagrip.view.live.stage import PARTS, Look
from getagrip.view.style import TRUE

if TYPE_CHECKING:
    from viser import ViserServer

LABELS = {
    "hand": "hand", "object": "object", "axis": "latent axis", "contact": "contact", "truth": "ground truth",
    "camera": "camera",
}  # fmt: skip
MOST_MM = 20
"""Largest threshold of contact that may be chosen [mm]."""
WIDE = 400
"""Of the panel of pictures [px]."""
GO_TO_FRAME = (
    "const s=document.getElementById('{slider}'),box=s&&s.parentElement.querySelector('input:not([type=hidden])');"
    "if(box){{Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call(box,String(frame));"
    "box.dispatchEvent(new Event('input',{{bubbles:true}}));}}"
)
"""viser tells nobody of presses on a plot: they are typed into the box of the frame's slider, {slider}."""


@dataclass(frozen=True)
class Heard:
    """What happens when a control is used; each is called in a thread of viser's."""

    frame: Callable[[int], None]
    step: Callable[[int], None]
    play: Callable[[], None]
    speed: Callable[[float], None]
    look: Callable[[Look], None]
    candidate: Callable[[int, int], None]
    entry: Callable[[int], None]
    through_camera: Callable[[], None]


class Panel:
    """All controls, for the columns that are shown now."""

    def __init__(self, server: ViserServer, heard: Heard, entries: Sequence[str]) -> None:
        self._gui, self._heard = server.gui, heard
        self._gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(42, 127, 158))
        self._gui.set_panel_label("getagrip view")
        self._gui.main_panel.dock_right()
        self._pictures = self._gui.add_panel()
        self._tab = self._pictures.add_tab("Image and curves")
        self._pictures.dock_left()
        self._pictures.set_width(WIDE)
        if len(entries) > 1:
            self._list(entries)
        self._parts: list[Any] = []
        self._gui.add_command("Play or pause", hotkey="P").on_trigger(lambda _: heard.play())
        self._gui.add_command("Next frame", hotkey="E").on_trigger(lambda _: heard.step(1))
        self._gui.add_command("Previous frame", hotkey="Q").on_trigger(lambda _: heard.step(-1))

    def _list(self, entries: Sequence[str]) -> None:
        """What can be shown, the worst first."""
        folder = self._gui.add_folder(f"{len(entries)} clips, worst first")
        with folder:
            chosen: Any = self._gui.add_dropdown("clip", tuple(entries), initial_value=entries[0])
            steps = self._gui.add_button_group("", ("previous", "next"))

        @chosen.on_update
        def _(_: Any) -> None:
            self._heard.entry(entries.index(chosen.value))

        @steps.on_click
        def _(_: Any) -> None:
            step = 1 if steps.value == "next" else -1
            chosen.value = entries[(entries.index(chosen.value) + step) % len(entries)]

    def open(self, columns: Sequence[Column], choices: Sequence[str], look: Look) -> None:
        """Controls for other columns in the place of the former ones."""
        for part in self._parts:
            part.remove()
        gui, T = self._gui, len(columns[0].view.result.frames)
        playing = gui.add_folder("Playback")
        with playing:
            self._slider: Any = gui.add_slider("frame", 1, max(T, 2), 1, 1, disabled=T < 2)
            self._play = gui.add_button("Play", hint="key P")
            step = gui.add_button_group("step", ("◀ back", "forward ▶"), hint="keys Q and E")
            speed = gui.add_dropdown("speed", tuple(f"{s:g}x" for s in SPEEDS), initial_value="1x")
            self._frame = gui.add_markdown("")
        slider = self._slider

        @slider.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # else it follows the player
                self._heard.frame(int(slider.value) - 1)

        self._play.on_click(lambda _: self._heard.play())
        step.on_click(lambda _: self._heard.step(1 if "forward" in step.value else -1))
        speed.on_update(lambda _: self._heard.speed(float(speed.value[:-1])))
        tabs = gui.add_tab_group()
        with tabs.add_tab("About"):
            gui.add_markdown(words.about_clip(columns[0]))
            for column in columns:
                gui.add_markdown(words.about_result(column))
                if meaning := words.about_probabilities(column):
                    with gui.add_folder("What the probabilities mean", expand_by_default=False):
                        gui.add_markdown(meaning)
        self._compared = []
        if any(column.is_result for column in columns):
            with tabs.add_tab("Candidates"):
                self._compared = [self._candidates(k, column, len(columns)) for k, column in enumerate(columns)]
        with tabs.add_tab("View"):
            self._view(columns, choices, look)
        self._parts = [playing, tabs]
        self._beside(columns)

    def _candidates(self, k: int, column: Column, columns: int) -> Any:
        """The list of a column's candidates, and the text that compares them."""
        names = tuple(words.candidate_name(column, rank) for rank in range(len(column.candidates.energy)))
        if not column.is_result:
            return None
        if columns > 1:
            self._gui.add_markdown(f"**{words.quoted(column.name)}**")
        chosen = self._gui.add_dropdown("candidate", names, initial_value=names[0], disabled=len(names) < 2)
        chosen.on_update(lambda _: self._heard.candidate(k, names.index(chosen.value)))
        return self._gui.add_markdown("measuring ...")

    def _view(self, columns: Sequence[Column], choices: Sequence[str], look: Look) -> None:
        """What is shown, and what stands still."""
        gui = self._gui
        still = gui.add_dropdown("stands still", tuple(choices), initial_value=look.still)
        absent = {"truth"} if all(column.truth is None for column in columns) else set()
        absent |= {"axis"} if all(column.axis_ends is None for column in columns) else set()
        absent |= {"object", "contact"} if not any(column.posed for column in columns) else set()
        boxes = {part: gui.add_checkbox(LABELS[part], part in look.parts) for part in PARTS if part not in absent}
        contact = gui.add_slider(
            "contact, mm", 0, MOST_MM, 1, round(1e3 * look.contact), hint="hand and object touch within so much"
        )
        gui.add_button("Look through the camera").on_click(lambda _: self._heard.through_camera())

        def changed(_: Any) -> None:
            parts = frozenset(part for part, box in boxes.items() if box.value)
            self._heard.look(Look(parts, still.value, contact.value / 1e3))

        controls: list[Any] = [still, contact, *boxes.values()]
        for control in controls:
            control.on_update(changed)

    def _beside(self, columns: Sequence[Column]) -> None:
        """The picture and the curves, in the panel on the left."""
        with self._tab:
            self._image = self._gui.add_image(np.full((8, 8, 3), 255, np.uint8))
            self._names = self._gui.add_html("")
            self._plots = self._gui.add_html("")
        self._parts += [self._image, self._names, self._plots]

    def frame(self, n: int, text: str, picture: UInt8[ndarray, "H W 3"], plots: Sequence[Plot]) -> None:
        """Show frame ``n``: its name and numbers, its picture, its place on the curves."""
        self._slider.value = n + 1
        self._frame.content = words.quoted(text)
        self._image.image = picture
        press = GO_TO_FRAME.format(slider=self._slider._impl.uuid)
        self._plots.content = '<div style="padding:0 10px">' + "".join(plot.svg(n, press) for plot in plots) + "</div>"

    def names(self, columns: Sequence[Column]) -> None:
        """Which contour and which curve is what."""
        curves = [Curve(c.name, np.zeros(1), COLOURS[k % len(COLOURS)]) for k, c in enumerate(columns)]
        known = any(column.truth is not None for column in columns)
        truth = [Curve(TRUTH, np.zeros(1), TRUE, True)] if known else []
        self._names.content = f'<div style="padding:0 10px">{legend(curves + truth)}</div>'

    def playing(self, playing: bool) -> None:
        """Name the button for what it does next."""
        self._play.label = "Pause" if playing else "Play"

    def compared(self, k: int, known: Sequence[Numbers], rank: int) -> None:
        """Say what speaks for and against a column's candidate."""
        if k < len(self._compared) and self._compared[k] is not None:
            self._compared[k].content = words.comparison(known, rank)
