//! Job files, spool folders and the journal database.
