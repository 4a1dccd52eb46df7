//! File formats, read from any `Read` and written to any `Write`.

pub mod csv;
