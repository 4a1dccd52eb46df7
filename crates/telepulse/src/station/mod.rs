//! The stations: the rig at the doctor's side, and the two ends of the link.

pub mod adaptive;
pub mod control;
pub mod device;
pub mod doctor;
pub mod relay;
pub mod replay;
pub mod run;
