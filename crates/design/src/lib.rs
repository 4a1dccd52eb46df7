//! telepulse-design.
