-- Views over the published tables, and named queries for the most frequent questions. `condvln query TARGET --list` prints
-- them. A block begins with its kind and name, and of a view the tables that it reads; the second line says what its rows
-- are, those after it describe the columns of a view that its first table does not have.

-- view: leaves of episodes, instructions
-- one row for each leaf of each episode, gold or not
-- leaf: number of the leaf within its instruction, from 0
-- gold: the truths of the conditions lead to this leaf
-- object_id: object that is the goal of the leaf, in the table objects
-- label: label of the goal
-- room: label of the room of the goal
-- n_goals: number of goal points around the goal, at any of which an agent may stop
-- n_subgoals: number of stops before the goal
-- geodesic_distance: metres on the navmesh from the start straight to the goal
-- route_length: metres on the navmesh from the start by all stops to the goal
SELECT e.source, e.scene_id, e.episode_id, e.instruction_id, e.category,
       leaf.leaf, leaf.leaf = e.gold_leaf AS gold, leaf.object_id,
       i.leaves[leaf.leaf + 1].moves[-1].label AS label,
       i.leaves[leaf.leaf + 1].moves[-1].room.label AS room,
       len(leaf.goals) AS n_goals, len(leaf.subgoals) AS n_subgoals,
       leaf.geodesic_distance, leaf.route_length
FROM episodes AS e JOIN instructions AS i USING (source, scene_id, instruction_id),
     unnest(e.leaves) AS unnested(leaf);

-- view: conditions of instructions
-- one row for each condition of each instruction
-- condition: number of the condition within its instruction, from 0
-- label: label that the condition asks for
-- room: label of the room in which it asks for it
-- predicate: relation that it asks for, null where it asks only whether the label is there
-- anchor: label of the object that the relation is to
-- other_anchor: label of the second such object, of the predicate between
-- truth: the condition holds in the scene
-- n_witnesses: number of objects that make it true, 0 where it is false
SELECT source, scene_id, instruction_id, category, position - 1 AS condition,
       conditions[position].label AS label, conditions[position].room.label AS room,
       conditions[position].qualifier.predicate AS predicate,
       conditions[position].qualifier.anchors[1].label AS anchor,
       conditions[position].qualifier.anchors[2].label AS other_anchor,
       conditions[position].truth AS truth, len(conditions[position].witnesses) AS n_witnesses
FROM instructions, unnest(range(1, len(conditions) + 1)) AS unnested(position);

-- view: labelled_relations of relations, objects, rooms
-- relations with the labels of both objects and of their room
-- room_label: label of the room
-- subject_label: label of the object that the relation is of
-- target_label: label of the object that the relation is to
SELECT r.*, room.label AS room_label, s.label AS subject_label, t.label AS target_label
FROM relations AS r
JOIN rooms AS room USING (source, scene_id, room_id)
JOIN objects AS s ON (s.source, s.scene_id, s.object_id) = (r.source, r.scene_id, r.subject)
JOIN objects AS t ON (t.source, t.scene_id, t.object_id) = (r.source, r.scene_id, r.target);

-- query: overview
-- scenes, rooms, objects, instructions and episodes of each source
SELECT source,
       count(*) FILTER (status = 'ok') AS scenes, count(*) FILTER (status <> 'ok') AS skipped,
       sum(n_rooms)::BIGINT AS rooms, sum(n_objects)::BIGINT AS objects,
       (SELECT count(*) FROM instructions AS i WHERE i.source = s.source) AS instructions,
       (SELECT count(*) FROM episodes AS e WHERE e.source = s.source) AS episodes
FROM scenes AS s GROUP BY source ORDER BY source;

-- query: categories
-- episodes, path lengths and words by category
SELECT category, count(*) AS episodes, count(DISTINCT scene_id) AS scenes,
       round(avg(moves), 2) AS moves, round(avg(geodesic_distance), 2) AS geodesic_m,
       round(avg(route_length), 2) AS route_m, round(avg(words), 1) AS words, max(max_steps) AS max_steps
FROM episodes GROUP BY category ORDER BY category;

-- query: balance
-- evenness of the gold leaf within a category of a source: 1 is even
SELECT source, category, any_value(n_leaves) AS leaves, gold_leaf, count(*) AS episodes,
       round(count(*) * any_value(n_leaves) / sum(count(*)) OVER (PARTITION BY source, category), 3) AS evenness
FROM episodes GROUP BY source, category, gold_leaf ORDER BY source, category, gold_leaf;

-- query: axes
-- episodes by composition, observability (O0f: all evidence in the first view) and number of moves
SELECT composition, if(observability = 'O0' AND evidence_in_view, 'O0f', observability) AS observability, moves, count(*) AS episodes
FROM episodes GROUP BY ALL ORDER BY ALL;

-- query: gold-labels
-- goal labels of the gold leaves, the most frequent first
SELECT gold_label, count(*) AS episodes, round(count(*) / sum(count(*)) OVER (), 4) AS share
FROM episodes GROUP BY gold_label ORDER BY episodes DESC, gold_label;

-- query: truth-by-label
-- how often a condition's label is true; far from one half, the label reveals the answer
SELECT source, label, room, count(*) AS conditions, round(avg(truth::INTEGER), 3) AS share_true,
       count(*) FILTER (predicate IS NOT NULL) AS relational
FROM conditions GROUP BY source, label, room ORDER BY conditions DESC, source, label, room;

-- query: rejections
-- why candidates were rejected, by stage
SELECT stage, reason, sum(count)::BIGINT AS candidates, count(DISTINCT scene_id) AS scenes, any_value(meaning) AS meaning
FROM rejections LEFT JOIN reasons USING (stage, reason) GROUP BY stage, reason ORDER BY candidates DESC, stage, reason;

-- query: funnel
-- for each source, category and cell: episodes wanted, candidates drawn, rejected and placed, episodes missing
SELECT source, category, cell, count(*) AS scenes, sum(wanted)::BIGINT AS wanted,
       sum(candidates)::BIGINT AS candidates, sum(rejected)::BIGINT AS rejected,
       sum(placed)::BIGINT AS placed, round(sum(placed) / nullif(sum(candidates), 0), 3) AS share_placed,
       sum(greatest(wanted - placed, 0))::BIGINT AS missing
FROM funnel GROUP BY source, category, cell ORDER BY source, category, cell;

-- query: skipped
-- scenes that were skipped, and why
SELECT source, scene_id, reason, n_rooms, n_objects FROM scenes WHERE status <> 'ok' ORDER BY ALL;

-- query: warnings
-- warnings of the readers, by code
SELECT source, warning.code AS code, count(*) AS warnings, count(DISTINCT scene_id) AS scenes,
       min(warning.message) AS example
FROM scenes, unnest(warnings) AS unnested(warning) GROUP BY ALL ORDER BY warnings DESC, source, code;

-- query: objects
-- objects by label, and how their geometry is known
SELECT label, count(*) AS objects, count(DISTINCT (source, scene_id)) AS scenes,
       count(*) FILTER (geometry = 'mesh') AS with_mesh, count(*) FILTER (geometry = 'none') AS without_extent
FROM objects GROUP BY label ORDER BY objects DESC, label;

-- query: predicates
-- relations by predicate, and how many have the margin that text requires
SELECT kind, predicate, count(*) AS relations, count(*) FILTER (true_in_text) AS true_in_text,
       round(median(used_distance), 2) AS median_m
FROM relations GROUP BY kind, predicate ORDER BY relations DESC, kind, predicate;

-- query: groups
-- counterfactual groups by their number of variants
SELECT variants, count(*) AS groups
FROM (SELECT group_id, count(*) AS variants FROM episodes WHERE group_id IS NOT NULL GROUP BY source, group_id)
GROUP BY variants ORDER BY variants;
