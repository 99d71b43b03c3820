# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writes AEDAT4 files with dv-processing; run by an interpreter that has it.

Arguments: a file of arrays (.npz), then names of compressions; each gives a file beside the arrays.
"""

from __future__ import annotations

import sys
from pathlib import Path

import dv_processing as dv
import numpy as np


def main(arrays_path, *compressions):
    arrays = dict(np.load(arrays_path))
    for name in compressions:
        write(arrays, Path(arrays_path).with_name(f'{name}.aedat4'), name)


def write(arrays, path, compression):
    config = dv.io.MonoCameraWriter.Config(
        'DAVIS346_V0000042', getattr(dv.CompressionType, compression)
    )
    config.addEventStream((346, 260))
    config.addFrameStream((346, 260))
    config.addImuStream()
    config.addTriggerStream()
    writer = dv.io.MonoCameraWriter(str(path), config)
    writer.setPackagingCount(64)
    for start in range(0, len(arrays['t']), 700):
        store = dv.EventStore()
        for index in range(start, min(start + 700, len(arrays['t']))):
            store.push_back(*(int(arrays[n][index]) for n in 'txy'), bool(arrays['p'][index]))
        writer.writeEvents(store)
    for t, exposure, image in zip(
        arrays['frame_t'], arrays['frame_exposure'], arrays['frame_image'], strict=True
    ):
        frame = dv.Frame(int(t), int(exposure), 3, 5, image, dv.FrameSource.SENSOR)
        writer.writeFrame(frame)
    for row in arrays['imu']:
        writer.writeImu(dv.IMU(int(row[0]), *row[1:].tolist(), 0.0, 0.0, 0.0))
    for t, kind in arrays['triggers'].tolist():
        writer.writeTrigger(dv.Trigger(t, dv.TriggerType(kind)))


if __name__ == '__main__':
    main(*sys.argv[1:])
