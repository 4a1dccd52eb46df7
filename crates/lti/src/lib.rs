//! telepulse-lti.
