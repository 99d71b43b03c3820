# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong while bringing the graph up or reading its recordings."""

from mixtac_events.errors import MixtacError


class GraphError(MixtacError):
    """A node that did not start, died, or could not be configured."""


class BagError(MixtacError):
    """A recording that is missing, damaged, or without the topics asked for."""


class ViewError(MixtacError):
    """A live view that cannot be served or written."""


class ExperimentError(MixtacError):
    """An experiment that does not exist or cannot be carried out."""
