-- Runs that were declared together, and what was found of the hosts before each.

ALTER TABLE run ADD COLUMN experiment TEXT;  -- JSON: name, id, configuration (pairs), repeat; NULL: of none
ALTER TABLE run ADD COLUMN conditions TEXT;  -- JSON: host, about, found, grade, advice of each; NULL: nobody looked

CREATE INDEX run_of_experiment ON run (experiment ->> 'id', number) WHERE experiment IS NOT NULL;
