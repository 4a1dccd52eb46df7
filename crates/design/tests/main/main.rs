//! Tests of the desk through its public interface.

#![allow(clippy::print_stdout)]

mod controller_order;
mod dk;
mod family;
mod forms;
mod identification;
mod implementation;
mod loop_synthesis;
mod mu_matrix;
mod mu_system;
mod parametric;
mod printed;
mod synthesis;
mod synthesis_laws;
mod verification;
