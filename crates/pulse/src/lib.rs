//! telepulse-pulse.
