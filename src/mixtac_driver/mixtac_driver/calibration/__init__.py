# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Camera calibration: checkerboard views, lens models, camera_info files, undistortion."""
