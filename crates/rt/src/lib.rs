//! telepulse-rt.
