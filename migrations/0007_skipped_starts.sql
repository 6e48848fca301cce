-- Starts of an open loop that were skipped before the iterations of a run, however these ended; without the warm-up.

ALTER TABLE run ADD COLUMN skipped_starts INTEGER NOT NULL DEFAULT 0;

-- Of the runs of before: those before answered iterations stand in the statistics, the others in the nodes that are left.
UPDATE run SET skipped_starts = CAST(coalesce(max(0.0, min(9007199254740992.0, round(
    (SELECT total(rollup.count * rollup.mean) FROM rollup
     WHERE rollup.run = run.number AND rollup.resolution_s = 0 AND rollup.bucket_s = 0 AND rollup.quantity = 0
     AND rollup.name IN (SELECT id FROM name WHERE text = 'skipped-starts'))
  + (SELECT total(node.value) FROM iteration INDEXED BY iteration_without_answer
     CROSS JOIN node ON node.run = iteration.run AND node.iteration = iteration.number
     WHERE iteration.run = run.number AND iteration.outcome <> 0 AND iteration.warm_up = 0
     AND node.value > 0 AND node.name IN (SELECT id FROM name WHERE text = 'skipped-starts'))
))), 0.0) AS INTEGER)
WHERE EXISTS (SELECT 1 FROM name WHERE text = 'skipped-starts');
