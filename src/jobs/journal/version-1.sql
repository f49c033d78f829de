-- A journal as celld wrote it with schema version 1, after one job and with another one waiting.
CREATE TABLE jobs (
  sequence      INTEGER PRIMARY KEY AUTOINCREMENT,
  id            TEXT NOT NULL UNIQUE,
  name          TEXT NOT NULL,
  sha256        TEXT NOT NULL,
  text          TEXT NOT NULL,
  spec          TEXT NOT NULL,
  state         TEXT NOT NULL CHECK (state IN ('waiting','active','done','failed','cancelled','interrupted')),
  priority      INTEGER NOT NULL,
  head          INTEGER NOT NULL DEFAULT 0,
  not_before    REAL,
  approved      TEXT,
  claimed       REAL NOT NULL,
  started       REAL,
  ended         REAL,
  result        TEXT,
  source        TEXT,
  folder        TEXT,
  placed_as     TEXT
);
CREATE UNIQUE INDEX one_active ON jobs (state) WHERE state = 'active';
CREATE INDEX jobs_state ON jobs (state);
CREATE INDEX jobs_source ON jobs (source) WHERE source IS NOT NULL;
CREATE TABLE steps (
  job     INTEGER NOT NULL REFERENCES jobs (sequence),
  step    INTEGER NOT NULL,
  intent  TEXT NOT NULL,
  phase   TEXT NOT NULL CHECK (phase IN ('intent','gripped','released','done','abandoned')),
  changed REAL NOT NULL,
  PRIMARY KEY (job, step)
);
CREATE UNIQUE INDEX one_open_step ON steps (job) WHERE phase IN ('intent','gripped','released');
CREATE TABLE rejections (
  sequence INTEGER PRIMARY KEY AUTOINCREMENT,
  name     TEXT NOT NULL,
  stored   TEXT NOT NULL UNIQUE,
  code     TEXT NOT NULL,
  reason   TEXT NOT NULL,
  time     REAL NOT NULL,
  source   TEXT NOT NULL,
  moves    INTEGER NOT NULL,
  settled  INTEGER NOT NULL DEFAULT 0
);
CREATE INDEX rejections_source ON rejections (source);
INSERT INTO jobs (sequence, id, name, sha256, text, spec, state, priority, approved, claimed, started, ended, result, folder, placed_as)
VALUES (1, 'tidy', 'tidy.yaml', '00', 'version: 1', '{"id":"tidy","goal":[{"id":"mug","pose":[0.1,0.2,0.3]}],"objective":"pp","solver":null,"time_limit_s":null,"seed":7,"priority":0,"not_before_unix_s":null,"approval":"job","rerun":false}',
        'done', 0, 'plan 1', 1795248000.0, 1795248001.0, 1795248031.0, '{"id":"tidy","status":"done","code":"done","message":"every object is at its goal","hint":"","moves":1,"lower_bound":1.0,"seconds":30.0,"objects":[{"id":"mug","goal":[0.1,0.2,0.3],"measured":[0.1,0.2,0.3],"error_mm":0.0,"error_deg":0.0}]}',
        'done/2026-11/tidy', 'done');
INSERT INTO jobs (sequence, id, name, sha256, text, spec, state, priority, claimed)
VALUES (2, 'waits', 'waits.yaml', '11', 'version: 1', '{"id":null,"goal":[{"id":"mug","pose":[0.3,0.2,0.0]}],"objective":null,"solver":null,"time_limit_s":null,"seed":null,"priority":0,"not_before_unix_s":null,"approval":null,"rerun":false}',
        'waiting', 0, 1795248100.0);
INSERT INTO steps VALUES (1, 1, '{"object":"mug","from":[0.4,0.2,0.0],"to":[0.1,0.2,0.3],"kind":"goal"}', 'done', 1795248020.0);
PRAGMA user_version=1;
