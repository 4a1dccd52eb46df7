//! telepulse-link.
