"""What a run of a plane body leaves in its folder: fields at the stations and in between, metrics of the shear band."""

from __future__ import annotations

from dataclasses import asdict
from math import floor
from typing import Any

from cosserat_fx.output.layer_observation import Row
from cosserat_fx.output.plane_bands import NoBandError, measure_band
from cosserat_fx.output.plane_fields import PlaneFieldWriter, PlaneState
from cosserat_fx.output.plane_observation import PlaneObserver
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.plane import Plane
from cosserat_fx.results import RunFolder
from cosserat_fx.stepping import Step


class PlaneRecording:
    """Records a plane body; see :class:`~cosserat_fx.output.recording.Recording`."""

    profile_columns: tuple[str, ...] = ()

    def __init__(self, plane: Plane) -> None:
        """Prepare to observe.

        Args:
            plane: what is run.
        """
        scene, self._comm = plane.scene, plane.problem.comm
        self._plane, self._output = plane, scene.output
        self._observer = PlaneObserver(
            plane.problem, tuple(scene.boundaries), scene.output.columns, start=plane.path.start
        )
        self.columns = self._observer.columns
        self._fields: PlaneFieldWriter | None = None
        self._boundaries = self._observer.boundaries()
        self._frame = 0
        self._last = self._written = -plane.path.start
        self._band: dict[str, Any] = {}

    def travel(self, step: Step) -> float:
        """Travel of a step from the start of the first leg (m)."""
        return self._observer.travel(step)

    def row(self, step: Step) -> Row:
        """The history's row of a step just accepted."""
        self._last = self._observer.travel(step)
        return self._observer.row(step)

    def start(self, folder: RunFolder) -> None:
        """Write the initial fields."""
        self._begin_fields(folder, [])
        self._write_fields()

    def memento(self) -> dict[str, Any]:
        """The last step, and the fields that are written."""
        fields = self._fields.written if self._fields else []
        return {"last": self._last, "written": self._written, "frame": self._frame, "fields": fields}

    def resume(self, folder: RunFolder, memento: dict[str, Any]) -> None:
        """Go on in a run's folder."""
        self._last, self._written, self._frame = (memento[name] for name in ("last", "written", "frame"))
        self._begin_fields(folder, memento["fields"])

    def record(self, step: Step) -> None:
        """Write the fields where the first leg begins, at stations, and with the first step into each part of it."""
        met = step.travel == self._plane.path.start or step.travel in self._plane.stations
        if self._next_frame(step.travel) or met:
            self._write_fields()

    def finish(self) -> None:
        """Write the state after the last step, and measure the shear band in it."""
        if self._written != self._last:
            self._write_fields()
        state = self._observer.state(self._last)
        self._band = on_first_rank(self._comm, lambda: {} if state is None else self._measure(state))

    def entries(self) -> dict[str, Any]:
        """Stations, and metrics of the shear band or the reason why there is none."""
        stations = [station - self._plane.path.start for station in self._plane.stations]
        return {"stations_m": stations, **self._band}

    def _measure(self, state: PlaneState) -> dict[str, Any]:
        """Metrics of the shear band or the reason why there is none, on rank 0."""
        try:
            return {"band": asdict(measure_band(state, self._boundaries, d50=self._plane.scene.material.d50))}
        except NoBandError as reason:
            return {"no_band": str(reason)}

    def _next_frame(self, travel: float) -> bool:
        """Whether a travel (m, from the start of the loads) is the first in another of the path's equal parts."""
        path, frames = self._plane.path, self._output.frames
        done = (travel - path.start) / (path.length - path.start)
        frame = max(0, floor(frames * done * (1 + 1e-12)))
        entered, self._frame = frame > self._frame, max(frame, self._frame)
        return entered

    def _begin_fields(self, folder: RunFolder, written: list[float]) -> None:
        """Make the writer of the fields, on rank 0, after those that are there (travels in m)."""

        def begin() -> None:
            self._fields = PlaneFieldWriter(folder.fields, written)

        if self._output.fields:
            on_first_rank(self._comm, begin)

    def _write_fields(self) -> None:
        self._written = self._last
        if not self._output.fields:
            return
        state = self._observer.state(self._last)

        def write() -> None:
            if self._fields is not None and state is not None:
                self._fields.write(state)

        on_first_rank(self._comm, write)
