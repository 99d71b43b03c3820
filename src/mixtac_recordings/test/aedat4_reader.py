# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reads an AEDAT4 file with dv-processing; run by an interpreter that has it.

Arguments: the file, and the .npz to write.
"""

from __future__ import annotations

import sys

import dv_processing as dv
import numpy as np


def batches(read):
    while (batch := read()) is not None:
        yield batch


def main(path, out):
    recording = dv.io.MonoCameraRecording(path)
    events = np.concatenate([batch.numpy() for batch in batches(recording.getNextEventBatch)])
    frames = list(batches(recording.getNextFrame))
    samples = [sample for batch in batches(recording.getNextImuBatch) for sample in batch]
    triggers = [each for batch in batches(recording.getNextTriggerBatch) for each in batch]
    np.savez(
        out,
        t=events['timestamp'],
        x=events['x'],
        y=events['y'],
        polarity=events['polarity'].astype(bool),
        frame_t=[frame.timestamp for frame in frames],
        frame_exposure=[round(frame.exposure.total_seconds() * 1e6) for frame in frames],
        frame_image=np.stack([frame.image for frame in frames]),
        imu_t=[s.timestamp for s in samples],
        imu_acceleration=[[getattr(s, f'accelerometer{a}') for a in 'XYZ'] for s in samples],
        imu_rotation=[[getattr(s, f'gyroscope{a}') for a in 'XYZ'] for s in samples],
        trigger=[[each.timestamp, int(each.type)] for each in triggers],
    )


if __name__ == '__main__':
    main(*sys.argv[1:])
