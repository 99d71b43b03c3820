# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Records the sensor's topics to an MCAP bag, on machines without `ros2 bag record`."""

from __future__ import annotations

import sys
from pathlib import Path

from mixtac_cli.parameters import RecorderParameters
from mixtac_cli.record.listener_node import Listener
from mixtac_cli.record.summary import add_recording, read_recordings
from mixtac_node.base_node import declare, run
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_recordings.recording import RecordingError


class RecorderNode(Listener):
    """Records from its start to its end; `mixtac record` is the same with checks and figures."""

    def __init__(self) -> None:
        super().__init__('recorder')
        self._p = declare(self, RecorderParameters)
        if not self._p.output:
            raise RecordingError('parameter output is empty: name the folder of the new bag')
        self._output = Path(self._p.output)
        read_recordings(self._output.absolute().parent / 'dataset.yaml')
        self.listen(self._p.reference_topic)
        self.start(self._output)
        self._diagnostics = DiagnosticsPublisher(self, 'recorder', self._status)

    def close(self) -> None:
        """Finish the bag."""
        try:
            summary = self.finish()
            if summary is None:
                return
            add_recording(self._output, summary, profile=self._p.profile, split=self._p.split)
        except RecordingError as error:
            self.get_logger().error(str(error))
            return
        say = self.get_logger().warning if summary.dropped else self.get_logger().info
        say(f'{self._output}: {summary.seconds:.1f} s, {summary.verdict()}')

    def _status(self) -> Status:
        writer = self.writer
        dropped = writer.dropped if writer else 0
        missing = {m.topic.name: m.missing for m in self.meters if m.missing}
        values: dict[str, object] = {
            'dropped': dropped,
            'messages': sum(m.messages for m in self.meters),
            'bytes': sum(m.octets for m in self.meters),
            **{f'missing {name}': count for name, count in missing.items()},
        }
        if writer is not None and writer.failure:
            return Status(WARN, f'nothing is written any more: {writer.failure}', values)
        if dropped:
            return Status(WARN, f'{dropped} messages lost: disk too slow', values)
        return Status(WARN if missing else OK, 'recording', values)


def main(args: list[str] | None = None) -> int:
    """Run the recorder node."""
    return run(RecorderNode, args)


if __name__ == '__main__':
    sys.exit(main())
