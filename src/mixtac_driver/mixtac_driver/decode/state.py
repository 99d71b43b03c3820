# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""State and counters that the decoder keeps from word to word.

Both are `int64` arrays. Their indices are plain module integers, because the compiler folds them
into the code.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

# Reasons for the kernel to hand control back.
DONE, FULL, FRAME, RESET = range(4)
(
    TIME,  # latest time [us]
    WRAP_BASE,  # time of the latest wrap [us]
    TIME_BEFORE_RESET,
    ROW,  # row of the next events, -1 before the first
    DVS_ROWS,
    DVS_COLUMNS,
    APS_COLUMNS,
    APS_ROWS,
    APS_INVERTED,
    FRAME_OPEN,  # 1 between the start and the end of a frame
    FRAME_BROKEN,  # 1 when the open frame misses something
    FRAME_GLOBAL,  # 1 global, 0 rolling shutter
    FRAME_START,
    EXPOSURE_START,  # -1 until seen
    EXPOSURE_END,
    FRAME_END,
    EXPOSURE_CYCLES,
    EXPOSURE_WORDS,
    ROI_HIGH,  # high byte waiting for its low byte
    ROI_WORDS,  # ROI values seen, complete at 4
    ROI_0,  # start column, start row, end column, end row
    ROI_1,
    ROI_2,
    ROI_3,
    SIZE_X,  # width and height of the open frame, user orientation
    SIZE_Y,
    COLUMNS,  # columns expected and samples per column, wire orientation
    SAMPLES,
    COLUMN_TYPE,  # 0 reset, 1 signal, -1 between columns
    RESET_COLUMNS,  # columns done of each type
    SIGNAL_COLUMNS,
    SAMPLE,  # samples done of the open column
    IMU_INDEX,  # next byte, -1 outside a sample, -2 awaiting its info byte
    IMU_INFO,
    IMU_SAMPLES,  # samples and, next to it, edges in the output arrays
    EDGES,
    STATE_SIZE,
) = range(37)
IMU_OUTSIDE, IMU_AWAITS_INFO = -1, -2
IMU_BYTES = 14
(
    C_WORDS,
    C_EVENTS,
    C_EVENTS_OUTSIDE,
    C_EVENTS_WITHOUT_ROW,
    C_ROWS,
    C_ROWS_OUTSIDE,
    C_TIMESTAMPS,
    C_TIMESTAMPS_BACKWARDS,
    C_WRAPS,
    C_RESETS,
    C_SPECIALS,
    C_SPECIALS_UNKNOWN,
    C_EDGES,
    C_SAMPLES,
    C_SAMPLES_UNEXPECTED,
    C_MISC,
    C_MISC_UNKNOWN,
    C_APS_UNEXPECTED,
    C_FRAMES,
    C_FRAMES_DROPPED,
    C_FRAMES_WITHOUT_EXPOSURE,
    C_ROI_OUTSIDE,
    C_IMU,
    C_IMU_DROPPED,
    C_IMU_UNEXPECTED,
    C_BYTES_DROPPED,
    C_BYTES_LOST,
    COUNTER_SIZE,
) = range(28)


@dataclass(frozen=True, slots=True)
class DecoderCounters:
    """Everything that the decoder saw, dropped or did not know, since it was made.

    Every word is in `words` and, beyond that, in exactly one of the counters that
    `words_accounted` adds up; the others say what became of some of them.

    Attributes:
        words: Words decoded.
        events: Events put out.
        events_outside: Events dropped because their column lies outside the array.
        events_without_row: Events dropped because no row address came before them.
        rows: Row addresses.
        rows_outside: Row addresses dropped because they lie outside the array.
        timestamps: Time stamps that were taken.
        timestamps_backwards: Stamps and wraps that would set the time back; it stayed.
        wraps: Wraps of the 15-bit time.
        resets: Resets of the camera's clock.
        specials: Known special words other than resets.
        specials_unknown: Special words without a known meaning.
        edges: Edges of the external input and the generator.
        samples: Samples of the frame converter.
        samples_unexpected: Those outside a column or beyond its end.
        misc: Known data words of frames and inertial samples.
        misc_unknown: Data words without a known meaning.
        aps_unexpected: Known frame words (samples aside) where none belong.
        frames: Frames put out.
        frames_dropped: Frames dropped because something was missing.
        frames_without_exposure: Frames put out whose exposure times had to be guessed.
        roi_outside: Regions corrected because they leave the array.
        imu: Inertial samples put out.
        imu_dropped: Inertial samples dropped because something was missing.
        imu_unexpected: Inertial words where none belong.
        bytes_dropped: Half words at the end of short packets.
        bytes_lost: Bytes that never reached the decoder, as told by `StreamDecoder.skip`.
    """

    words: int
    events: int
    events_outside: int
    events_without_row: int
    rows: int
    rows_outside: int
    timestamps: int
    timestamps_backwards: int
    wraps: int
    resets: int
    specials: int
    specials_unknown: int
    edges: int
    samples: int
    samples_unexpected: int
    misc: int
    misc_unknown: int
    aps_unexpected: int
    frames: int
    frames_dropped: int
    frames_without_exposure: int
    roi_outside: int
    imu: int
    imu_dropped: int
    imu_unexpected: int
    bytes_dropped: int
    bytes_lost: int

    @property
    def words_accounted(self) -> int:
        """Return the words by kind, added up: `words` unless the decoder is wrong."""
        return sum(getattr(self, name) for name in _ONE_PER_WORD)

    def as_dict(self) -> dict[str, int]:
        """Return the counters by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


_ONE_PER_WORD = (
    'events',
    'events_outside',
    'events_without_row',
    'rows',
    'rows_outside',
    'timestamps',
    'timestamps_backwards',
    'wraps',
    'resets',
    'specials',
    'specials_unknown',
    'samples',
    'misc',
    'misc_unknown',
)
