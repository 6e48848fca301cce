-- The process that introduced itself last, a random number of its start: when another one does, the runs of the one
-- before have ended, whether or not it could say so. NULL when none did since the database was made.
ALTER TABLE host ADD COLUMN process INTEGER;
CREATE INDEX run_open ON run (pipeline, number) WHERE ended_ns IS NULL;
