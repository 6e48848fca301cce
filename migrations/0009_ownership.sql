-- Whose data it is.

-- The secret that a host proves to have at every hello. A table of its own: whatever reads hosts reads no secret.
-- Without a row the next agent that comes with the host's id is enrolled.
CREATE TABLE host_secret (
    host        INTEGER PRIMARY KEY REFERENCES host (id),
    secret      BLOB NOT NULL,    -- 32 bytes
    enrolled_ns INTEGER NOT NULL  -- the aggregator's clock
) STRICT;

-- Runs belong to the host that reports them. The id under which a host reports a run, where another host had used that id
-- before; `uuid` is a random one then.
ALTER TABLE run ADD COLUMN reported_uuid TEXT;
CREATE INDEX run_reported ON run (reported_uuid) WHERE reported_uuid IS NOT NULL;
