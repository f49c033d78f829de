//! The tables of the journal database, and how older ones become these.
//!
//! In: nothing. Out: SQL, and the number of its version. A column that came later is at the end and may be
//! null: a reader of a database that no daemon has brought up to date reads null there (`rows`, `steps`).

/// Number in `PRAGMA user_version`. Older databases are brought up to it when the daemon opens them; one of
/// a larger number is refused.
pub(super) const SCHEMA_VERSION: i64 = 4;

/// What makes a database of version k + 1 out of one of version k, for k from 1.
pub(super) const MIGRATIONS: [&str; 3] = [
    "
ALTER TABLE jobs ADD COLUMN found TEXT;
ALTER TABLE jobs ADD COLUMN resolved TEXT;
ALTER TABLE jobs ADD COLUMN plan TEXT;
",
    "ALTER TABLE steps ADD COLUMN gripped REAL;",
    "
ALTER TABLE jobs ADD COLUMN found_at REAL;
ALTER TABLE jobs ADD COLUMN approved_at REAL;
ALTER TABLE steps ADD COLUMN note TEXT;
",
];

/// The tables of a new database.
pub(super) const SCHEMA: &str = "
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
  placed_as     TEXT,
  found         TEXT,
  resolved      TEXT,
  plan          TEXT,
  found_at      REAL,
  approved_at   REAL
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
  gripped REAL,
  note    TEXT,
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
";
