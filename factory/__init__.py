"""The work queue: units of work, stages and keys, parallel execution, committed shards, published snapshots.

It knows nothing of what the units are. ``jobs`` makes a ``Pipeline`` and lists ``Unit`` s; ``plan`` says what a run
would do, ``run`` does it and publishes a ``Snapshot``.
"""
