"""What a run of a layer leaves in its folder: profiles and fields at the stations, metrics of band and friction."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from cosserat_fx.layer import Layer
from cosserat_fx.output.layer_bands import band_metrics, friction_metrics
from cosserat_fx.output.layer_fields import FieldWriter
from cosserat_fx.output.layer_observation import Columns, LayerObserver, Row
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.results import HISTORY_COLUMNS, PROFILE_COLUMNS, RunFolder, read_run
from cosserat_fx.stepping import Step


class LayerRecording:
    """Records a layer; see :class:`~cosserat_fx.output.recording.Recording`."""

    columns = HISTORY_COLUMNS
    profile_columns = PROFILE_COLUMNS

    def __init__(self, layer: Layer) -> None:
        """Prepare to observe.

        Args:
            layer: what is run.
        """
        self._layer, self._comm = layer, layer.problem.comm
        self._observer = LayerObserver(layer)
        self._fields: FieldWriter | None = None
        self._last = 0, 0.0
        self._entries: dict[str, Any] = {}

    def travel(self, step: Step) -> float:
        """Travel of a step along the path (m)."""
        return step.travel

    def row(self, step: Step) -> Row:
        """The history's row of a step just accepted."""
        self._last = step.number, step.travel
        return self._observer.row(step)

    def start(self, folder: RunFolder) -> None:
        """Write the initial fields, and the profiles where they are asked for."""
        self._folder = folder
        self._begin_fields([])
        self._write_fields(0, 0.0)
        if 0.0 in self._layer.stations:
            self._write_profile(0, 0.0)

    def memento(self) -> dict[str, Any]:
        """The last step, and the fields that are written."""
        return {"last": self._last, "fields": self._fields.written if self._fields else []}

    def resume(self, folder: RunFolder, memento: dict[str, Any]) -> None:
        """Go on in a run's folder."""
        self._folder = folder
        step, travel = memento["last"]
        self._last = step, travel
        self._begin_fields(memento["fields"])

    def record(self, step: Step) -> None:
        """Write profiles and fields where they are asked for."""
        if step.travel in self._layer.stations:
            self._write_profile(step.number, step.travel)
            self._write_fields(step.number, step.travel)

    def finish(self) -> None:
        """Measure the band in the profiles after the last step, and the friction in the history."""
        profile = self._observer.profile(*self._last)
        self._entries = on_first_rank(self._comm, lambda: {} if profile is None else self._measure(profile))

    def entries(self) -> dict[str, Any]:
        """Metrics of the shear band, where anything was sheared, and of the friction."""
        return self._entries

    def _measure(self, profile: Columns) -> dict[str, Any]:
        """What :meth:`entries` gives, on rank 0."""
        scene, entries = self._layer.scene, {}
        pressure = -(profile["s11_Pa"] + profile["s22_Pa"] + profile["s33_Pa"]) / 3
        critical = scene.material.characteristic_void_ratios(pressure).e_c
        if np.any(profile["shear_strain"]):
            band = band_metrics(profile, critical, d50=scene.material.d50, height=scene.geometry.height)
            entries["band"] = asdict(band)
        return entries | {"friction": asdict(friction_metrics(read_run(self._folder.path).history))}

    def _begin_fields(self, written: list[float]) -> None:
        """Make the writer of the fields, on rank 0, after those that are there (travels in m)."""

        def begin() -> None:
            self._fields = FieldWriter(self._folder.fields, written)

        if self._layer.scene.output.fields:
            on_first_rank(self._comm, begin)

    def _write_profile(self, step: int, travel: float) -> None:
        profile = self._observer.profile(step, travel)
        on_first_rank(self._comm, lambda: None if profile is None else self._folder.append_profile(profile))

    def _write_fields(self, step: int, travel: float) -> None:
        if not self._layer.scene.output.fields:
            return
        nodes, profile = self._observer.nodes(), self._observer.profile(step, travel)

        def write() -> None:
            if self._fields is not None and nodes is not None and profile is not None:
                self._fields.write(travel, nodes, profile)

        on_first_rank(self._comm, write)
