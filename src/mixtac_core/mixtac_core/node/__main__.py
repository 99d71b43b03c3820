# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`python -m mixtac_core.node MODULE`: run the node of a module, as its executable does."""

import importlib
import sys

del sys.argv[0]
sys.exit(importlib.import_module(sys.argv[0]).main())
