//! A study: everything from the device to the report, as `study.toml` says.

pub mod ageing;
pub mod amend;
pub mod bias_sweep;
pub mod campaign;
pub mod config;
pub mod contact;
pub mod controllers;
pub mod disagreements;
mod drawings;
pub mod grey_box;
pub mod held_plate;
pub mod identify;
pub mod judge;
pub mod models;
pub mod outcome;
pub mod pulse_files;
pub mod recipes;
pub mod run;
pub mod trace;
pub mod tracking;
pub mod transmission;
