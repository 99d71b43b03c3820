# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which vibrations the events show (paper, section IV-A).

Two kinds of contact are compared. `pressed`: the vibrating body stays 0.6 mm deep in the skin; it
causes as many events on the way in as on the way out, so the event count repeats twice per
period. `tapping`: the body touches the skin for about a third of each period, which gives one
burst per period. A body that rests on the skin by its own weight leaves it as soon as its
acceleration exceeds g: at 50 Hz from an amplitude of 0.1 mm.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_events.arrays import Events
from mixtac_lab.experiments.harness import Outcome, Row, Value
from mixtac_lab.experiments.report import mark, new_figure, save_figure
from mixtac_lab.experiments.sizes import PRESET
from mixtac_lab.experiments.studies.tones import binned
from mixtac_lab.experiments.training import is_simulated
from mixtac_lab.store import sensor_digest
from mixtac_learning.trials.bags import bag_sources
from mixtac_recordings.recording import RecordingError
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.world.effects import preset
from mixtac_sim.world.profiles import Profile, Segment, Tone
from mixtac_sim.world.sensor import TactileSensor

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_lab.experiments.harness import Context


PRESSED, TAPPING = 'pressed', 'tapping'
DEPTH_MM = 0.6
"""How deep what vibrates stands, pressed [mm]."""
SIZES_MM = {PRESSED: (0.05, 0.1, 0.2), TAPPING: (0.8, 1.0)}
"""Pressed: amplitudes, zero to peak; tapping: depths of the dent [mm]."""
HOVER = 0.5
"""Tapping: height of the middle of the motion over the skin, in amplitudes; the rest is depth."""
SETTLED_S = 0.56
SHAKEN_S = (0.65, 1.65)
"""When the vibration is looked at [s]: its fading in has ended, and the gel has settled."""
_NAMED = re.compile(r'(\d+(?:\.\d+)?) ?hz', re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class Shaken:
    """What a camera saw of a vibration.

    Attributes:
        events: Sorted events; camera clock [us].
        frame: Image from before it, [260, 346] [DN].
        span_s: When it is looked at [s].
    """

    events: Events
    frame: NDArray[np.uint16]
    span_s: tuple[float, float]


def shake(kind: str, tone_hz: float, size_mm: float, seed: int) -> Shaken:
    """Return a vibration of the simulated sensor.

    Args:
        kind: `PRESSED` or `TAPPING`.
        tone_hz: Its frequency [Hz].
        size_mm: Amplitude, or depth of the dent; see `SIZES_MM` [mm].
        seed: Which sensor and day.
    """
    middle, amplitude = DEPTH_MM, size_mm
    if kind == TAPPING:
        amplitude = size_mm / (1.0 - HOVER)
        middle = -HOVER * amplitude
    tone = Tone(amplitude, tone_hz, 0.0, 0.05)
    end = SHAKEN_S[1]
    segments = (
        Segment(0.0, 0.2, Mode.POSITION, (0.0, 0.2), (min(-0.1, middle), middle)),
        Segment(0.2, SETTLED_S, Mode.POSITION, (0.0,), (middle,)),
        Segment(SETTLED_S, end + 0.1, Mode.POSITION, (0.0,), (middle,), (tone,)),
    )
    sensor = TactileSensor(seed, seed, Profile('vibration', end, segments), preset=preset(PRESET))
    output = sensor.advance(round(1e6 * end))
    still = [f.intensity for f in output.frames if f.frame_end_us < 1e6 * SETTLED_S]
    return Shaken(output.events, still[-1], SHAKEN_S)


def tone_of(name: str) -> float:
    """Return the frequency that the name of a bag says, such as `speaker_120hz` [Hz].

    Raises:
        RecordingError: It says none.
    """
    found = _NAMED.search(name)
    if found is None:
        raise RecordingError(
            f'bag {name} does not say its tone: name it after it, such as speaker_120hz'
        )
    return float(found.group(1))


def recorded(path: Path, settle_s: float = 1.0) -> Shaken:
    """Return a recorded vibration; events are looked at from `settle_s` on, in whole seconds.

    Args:
        path: A bag with events and frames of one tone.
        settle_s: From the begin of the recording until the tone is steady [s].

    Raises:
        RecordingError: The bag is damaged or holds no events.
        RecordingError: It is too short, or holds no frames.
    """
    from mixtac_recordings.camera_stream import BagRecording
    from mixtac_recordings.recording import NONE, Selection

    recording = BagRecording(path, Selection(imu=NONE))
    parts, frame = [], None
    try:
        for piece in recording.pieces(recording.info.start_us):
            parts.append(piece.events)
            if frame is None and piece.frames:
                frame = piece.frames[0].image
    finally:
        recording.close()
    events = Events.concatenate([part for part in parts if len(part)])
    seconds = int(1e-6 * (events.t[-1] - events.t[0]) - settle_s) if len(events) else 0
    if frame is None or seconds < 1:
        raise RecordingError(f'{path}: record frames and at least {1.0 + settle_s:g} s of the tone')
    start = 1e-6 * float(events.t[0]) + settle_s
    return Shaken(events, frame, (start, start + seconds))


COUNT, POLARITY, FLOW = 'count', 'polarity', 'flow'
"""Number of events; ON less OFF; polarity times the gradient of a frame."""
BINS_US = {COUNT: 2000, POLARITY: 2000, FLOW: 1000}
"""Length of a bin [us]: the paper's, and half of it where twice the drive has to fit."""
LOWEST_HZ = 30.0
"""Below lies the relaxation of the gel [Hz]."""
_FINER = 8
"""Zero padding: peaks are read to an eighth of the resolution."""


@dataclass(frozen=True, slots=True)
class ShakePiece:
    """One vibration of the simulated sensor.

    Attributes:
        kind: How it touches, see `mixtac_lab.experiments.paper.vibration`.
        tone_hz: Its frequency [Hz].
        size_mm: Amplitude or depth [mm].
        seed: Which sensor and day.
    """

    kind: str
    tone_hz: float
    size_mm: float
    seed: int

    @property
    def label(self) -> str:
        """All of it."""
        return f'shake_{self.kind}_{self.tone_hz:g}hz_{1e3 * self.size_mm:g}um_s{self.seed}'

    def identity(self) -> str:
        """Return the fields and the simulator."""
        return f'{asdict(self)} {sensor_digest()}'

    def compute(self, _folder: Path, _stem: str) -> dict[str, Any]:
        """Return dominant frequencies and spectra."""
        return spectra(shake(self.kind, self.tone_hz, self.size_mm, self.seed))


@dataclass(frozen=True, slots=True)
class BagShakePiece:
    """One recorded vibration.

    Attributes:
        path: The bag.
        tone_hz: Its frequency [Hz].
    """

    path: Path
    tone_hz: float

    @property
    def label(self) -> str:
        """Name of the bag."""
        return f'shake_{self.path.name}'

    def identity(self) -> str:
        """Return path, size and date of the bag's files."""
        return repr(
            [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in sorted(self.path.iterdir())]
        )

    def compute(self, _folder: Path, _stem: str) -> dict[str, Any]:
        """Return dominant frequencies and spectra.

        Raises:
            MixtacError: The bag cannot be used.
        """
        return spectra(recorded(self.path))


def spectra(shaken: Shaken) -> dict[str, Any]:
    """Return, per signal, `dominant_hz` and `spectrum`, one value per Hz, largest is 1."""
    found = {}
    for bin_us in sorted(set(BINS_US.values())):
        count, polarity, flow = binned(shaken.events, shaken.frame, shaken.span_s, bin_us)
        for name, signal in ((COUNT, count), (POLARITY, polarity), (FLOW, flow)):
            if BINS_US[name] == bin_us:
                found[name] = spectrum_of(signal, bin_us)
    return found


def spectrum_of(signal: NDArray[np.float64], bin_us: int) -> dict[str, Any]:
    """Return the dominant frequency of a signal and its spectrum from 0 Hz, per Hz.

    Args:
        signal: One value per bin.
        bin_us: Length of a bin [us].
    """
    windowed = (signal - signal.mean()) * np.hanning(len(signal))
    strength = np.abs(np.fft.rfft(windowed, _FINER * len(signal)))
    hz = np.fft.rfftfreq(_FINER * len(signal), 1e-6 * bin_us)
    strength[hz < LOWEST_HZ] = 0.0
    dominant = float(hz[int(np.argmax(strength))])
    top = max(float(strength.max()), 1e-12)
    whole = np.arange(int(hz[-1]) + 1)
    nearest = np.searchsorted(hz, whole - 0.5), np.searchsorted(hz, whole + 0.5)
    values = [float(strength[a:b].max(initial=0.0)) / top for a, b in zip(*nearest, strict=True)]
    return {'dominant_hz': dominant, 'spectrum': [round(value, 3) for value in values]}


TOLERANCE_HZ = 1.0
FIRST_SEED = 7300
"""Sensors that nothing was chosen on."""
_PLACE = 'section IV-A, Fig. 3'
SIGNALS = {
    COUNT: 'number of events, 2 ms bins',
    POLARITY: 'ON less OFF, 2 ms bins',
    FLOW: 'flow, 1 ms bins',
}
_PAPER = (
    'Tones of 50 to 250 Hz from a resonant speaker on the skin; number of events in bins of 2 ms,'
    ' Fourier transform; the dominant frequency equals the input.'
)
Found = tuple[float, dict[str, Any]]
"""Tone [Hz] and its spectra."""


def vibration(context: Context) -> Outcome:
    """Return how many tones are found within 1 Hz.

    Raises:
        MixtacError: A bag cannot be used.
    """
    return _simulated(context) if context.bags is None else _recorded(context, context.bags)


def _simulated(context: Context) -> Outcome:
    sizes = context.sizes
    cases = [(kind, size) for kind, both in SIZES_MM.items() for size in both]
    pieces = [
        ShakePiece(kind, tone, size, FIRST_SEED + seed)
        for kind, size in cases
        for tone in sizes.tones_hz + (sizes.fast_tones_hz if kind == PRESSED else ())
        for seed in range(context.seeds)
    ]
    results = context.run('vibration', pieces)
    pairs = list(zip(pieces, results, strict=True))
    rows: list[Row] = []
    for kind, size in cases:
        by_seed = [
            [
                (p.tone_hz, r)
                for p, r in pairs
                if (p.kind, p.size_mm, p.seed) == (kind, size, FIRST_SEED + s)
            ]
            for s in range(context.seeds)
        ]
        for signal in SIGNALS:
            rows += _rows(kind, size, signal, by_seed, sizes.tones_hz)
        if kind == PRESSED and sizes.fast_tones_hz:
            rows += _rows(kind, size, FLOW, by_seed, sizes.fast_tones_hz)
    panels = {
        f'{kind}, {1e3 * size:g} um:\n{SIGNALS[signal]}': [
            (p.tone_hz, r[signal])
            for p, r in pairs
            if (p.kind, p.size_mm) == (kind, size)
            and (signal == FLOW or p.tone_hz <= sizes.tones_hz[-1])
        ]
        for kind, signal in ((TAPPING, COUNT), (PRESSED, COUNT), (PRESSED, FLOW))
        for size in SIZES_MM[kind][:1]
    }
    path = _draw(context.figures / 'vibration.png', panels, simulated=True)
    return Outcome(
        name='vibration',
        title='Vibrations',
        paper=_PAPER,
        data=f'virtual sensor, preset {PRESET}, {context.seeds} sensors (seeds from {FIRST_SEED}),'
        f' {len(sizes.tones_hz)} tones of {sizes.tones_hz[0]:g} to {sizes.tones_hz[-1]:g} Hz and'
        f' {len(sizes.fast_tones_hz)} above, one second each',
        rows=rows,
        figures={'Spectra over the tone, mean of the sensors; dashed: reconstructed = input': path},
        deviations=(
            (
                'The paper names neither amplitude nor pre-load. Pressed in, a'
                ' vibration makes as many'
                ' events each way, and the number of events repeats at twice its'
                ' frequency, which 2 ms'
                ' bins fold back above 125 Hz. What breaks the symmetry is contact that is lost in'
                ' part of each period (tapping): one burst per period. Both are'
                ' shown. Unequal ON and'
                ' OFF thresholds break it too, but by less than the lamp ripple of this preset.'
            ),
            (
                'Flow is the polarity times the gradient of a frame from before, summed in cells of'
                ' 32 pixels, first principal component; it changes its sign with the'
                ' motion, so twice'
                ' the frequency does not appear.'
            ),
            'Tones keep 10 Hz from 100 and 200 Hz, where a lamp ripple would be taken for them.',
        ),
    )


def _recorded(context: Context, bags: Path) -> Outcome:
    folder = bags / 'vibration'
    paths = sorted(path.parent for path in folder.glob('*/metadata.yaml'))
    if not paths:
        raise RecordingError(
            f'{folder} holds no bags: record one bag per tone and name it after it, such as'
            ' speaker_120hz'
        )
    pieces = [BagShakePiece(path, tone_of(path.name)) for path in paths]
    results = context.run('vibration', pieces)
    found = [(piece.tone_hz, result) for piece, result in zip(pieces, results, strict=True)]
    tones = sorted({tone for tone, _ in found})
    simulated = any(is_simulated(bag) for bag in bag_sources(folder))
    kind = 'simulated bags' if simulated else 'recorded'
    rows = [row for signal in SIGNALS for row in _rows(kind, 0.0, signal, [found], tones)]
    panels = {SIGNALS[name]: [(tone, r[name]) for tone, r in found] for name in SIGNALS}
    path = _draw(context.figures / 'vibration.png', panels, simulated=simulated)
    return Outcome(
        name='vibration',
        title='Vibrations',
        paper=_PAPER,
        data=f'{len(paths)} bags in {folder.name}; tones from their names',
        rows=rows,
        figures={'Spectra over the tone; dashed: reconstructed = input': path},
    )


def _rows(
    kind: str,
    size_mm: float,
    signal: str,
    by_seed: Sequence[Sequence[Found]],
    tones: Sequence[float],
) -> list[Row]:
    """Return the share of tones that are found within 1 Hz, and the largest error."""
    errors = [
        [abs(found[signal]['dominant_hz'] - tone) for tone, found in each if tone in tones]
        for each in by_seed
    ]
    shares = Value.of(float(np.mean(np.array(each) <= TOLERANCE_HZ)) for each in errors)
    worst = Value.of(max(each) for each in errors)
    size = f', {1e3 * size_mm:g} um' if size_mm else ''
    span = f'{min(tones):g} to {max(tones):g} Hz'
    name = f'{kind}{size}, {SIGNALS[signal]}, {span}'
    counted = signal == COUNT and max(tones) <= 250.0
    simulated = kind != 'recorded'
    place = _PLACE if counted else ''
    text = f'{len(tones)} tones; within {TOLERANCE_HZ:g} Hz'
    paper = 1.0 if counted else None
    rows = [Row(f'{name}: share of tones', shares, paper, place, '', text, simulated)]
    if signal != POLARITY:
        text = f'{len(tones)} tones'
        rows.append(Row(f'{name}: largest error', worst, None, '', 'Hz', text, simulated))
    return rows


def _draw(path: Path, panels: dict[str, list[Found]], *, simulated: bool) -> Path:
    figure, axes = new_figure(columns=len(panels), width=3.6 * len(panels), height=4.0)
    for ax, (title, found) in zip(axes, panels.items(), strict=True):
        tones = np.array(sorted({tone for tone, _ in found}))
        columns = [
            np.mean([each['spectrum'] for tone, each in found if tone == chosen], axis=0)
            for chosen in tones
        ]
        highest = len(columns[0]) - 1
        # Columns are as wide as the tones lie apart.
        middles = 0.5 * (tones[1:] + tones[:-1])
        half = 0.5 * (tones[1] - tones[0]) if len(tones) > 1 else 5.0
        edges = np.concatenate([[tones[0] - half], middles, [tones[-1] + half]])
        picture = np.array(columns).T[30:]
        heights = np.arange(30, highest + 2) - 0.5
        mesh = ax.pcolormesh(edges, heights, picture, cmap='magma', vmin=0.0, vmax=1.0)
        ax.plot([30.0, highest], [30.0, highest], '--', color='#56b4e9', lw=1.0)
        ax.set(xlim=(edges[0], edges[-1]), ylim=(30.0, highest), xlabel='tone [Hz]')
        ax.set_title(f'{title}\n{mark(simulated)}', fontsize=9)
        ax.grid(visible=False)
    axes[0].set_ylabel('reconstructed [Hz]')
    figure.colorbar(mesh, ax=axes, label='amplitude / largest', fraction=0.03)
    return save_figure(figure, path)
