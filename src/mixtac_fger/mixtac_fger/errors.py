# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with models, training data and images; each text is one line."""

from mixtac_events.errors import MixtacError


class ModelError(MixtacError):
    """A model file that is missing, damaged or made for another architecture."""


class DatasetError(MixtacError):
    """Training data that cannot be read or do not fit the configuration."""


class ImageError(MixtacError):
    """An image message that the estimator cannot read."""


class ConfigError(MixtacError):
    """A network configuration with impossible values."""


class TareError(MixtacError):
    """A request for a new zero that would be wrong now."""


class ReferenceFileError(MixtacError):
    """A stored no-contact reference that cannot be read, written or used."""


class CalibrationError(MixtacError):
    """A measurement that a sensor cannot be calibrated with."""


class TrainingError(MixtacError):
    """A training run that cannot begin or go on."""
