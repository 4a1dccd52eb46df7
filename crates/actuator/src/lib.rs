//! telepulse-actuator.
