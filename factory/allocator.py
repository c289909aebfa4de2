"""Where Arrow takes its memory from: the C library, unless the environment says otherwise.

Arrow's own allocator keeps pages for every size of request that it has met: 15 MB in a driver that goes through many
small batches of many columns, and more of them with every kind of batch. Arrow reads the choice while it is loaded, so
this module comes first; where Arrow is there already, nothing changes.
"""

from __future__ import annotations

import os

os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
