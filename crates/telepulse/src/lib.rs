//! telepulse-telepulse.
