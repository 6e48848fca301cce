-- Of the events in `dropped`, those that were in the memory of an agent that was killed. An earlier release did not tell them
-- apart: for those only their gaps have the reason.
ALTER TABLE stream ADD COLUMN lost_when_killed INTEGER NOT NULL DEFAULT 0;
