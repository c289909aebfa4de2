"""Navigation as in habitat-sim, without habitat-sim: navmesh files, paths, steps, ground-truth walks, the builder."""
