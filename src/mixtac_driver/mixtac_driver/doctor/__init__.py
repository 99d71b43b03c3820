# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Looks at a camera and the computer it is plugged into, and says what to do about what is wrong.

Nothing here needs ROS or root, and nothing is changed on the computer.
"""
