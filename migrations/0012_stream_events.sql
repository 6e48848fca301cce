-- An agent says with each batch how many events all its batches hold up to there. By it the number of events is known that a
-- database which was deleted or restored lacks.
ALTER TABLE stream ADD COLUMN events INTEGER;  -- in all batches of the spool up to `stored`; NULL: unknown, stored by an earlier version
