//! Which states a run may be in, and what ends it.
//!
//! ```text
//! Disarmed --arm--> Armed --start--> Running --finish--> Disarmed
//!     ^               |                 |
//!     |            disarm              trip
//!     +---------------+                 v
//!     +------ acknowledge --------- Tripped
//! ```
//! Each transition consumes the state it leaves. Every state but `Running` yields one voltage only: zero.

use crate::error::{Error, not_negative, positive};
use crate::{
    ControlLoop, CycleInputs, CycleOutput, Drive, DriveVoltage, Limits, MonotonicNs, Sensor, SensorFault,
    TripReason, cycle,
};

/// When a run is no longer allowed to go on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SupervisorSettings {
    /// Largest tracking error, in the controlled variable's unit; infinite for none.
    pub error_limit: f64,
    /// How long the error may stay over its limit, in seconds.
    pub error_time_s: f64,
    /// Time between cycles, in seconds.
    pub period_s: f64,
    /// How late a cycle may begin, in seconds.
    pub overrun_tolerance_s: f64,
}

/// The drive is at zero volts and nobody intends to change that.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Disarmed;
/// The rig has been checked and a run may start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Armed;
/// Cycles are running.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Running {
    last_cycle: MonotonicNs,
    over_limit_since: Option<MonotonicNs>,
}
/// A run was ended for safety.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tripped {
    reason: TripReason,
}

/// The guard of a run in one of its four states.
///
/// **Example**
/// ```compile_fail
/// use telepulse_rt::{Disarmed, MonotonicNs, Supervisor};
/// fn hurry(supervisor: Supervisor<Disarmed>) {
///     supervisor.start(MonotonicNs(0)); // not armed: does not compile
/// }
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supervisor<State> {
    settings: SupervisorSettings,
    limits: Limits,
    state: State,
}

impl<State> Supervisor<State> {
    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &SupervisorSettings {
        &self.settings
    }

    fn with<Next>(self, state: Next) -> Supervisor<Next> {
        Supervisor { settings: self.settings, limits: self.limits, state }
    }
}

impl Supervisor<Disarmed> {
    /// A disarmed supervisor.
    ///
    /// # Errors
    /// [`Error::NotPositive`] or [`Error::Negative`] for a limit or time that is not usable.
    pub fn new(settings: SupervisorSettings, limits: Limits) -> Result<Self, Error> {
        // An infinite limit switches the error check off; anything else must be a positive number.
        if settings.error_limit != f64::INFINITY {
            positive("tracking error limit", settings.error_limit)?;
        }
        not_negative("time over the tracking error limit in seconds", settings.error_time_s)?;
        positive("cycle period in seconds", settings.period_s)?;
        not_negative("cycle overrun tolerance in seconds", settings.overrun_tolerance_s)?;
        Ok(Self { settings, limits, state: Disarmed })
    }

    /// Checks the rig: it must accept zero volts and deliver a finite reading.
    ///
    /// # Errors
    /// A tripped supervisor with the rig's fault.
    pub fn arm<R: Sensor + Drive>(
        self,
        rig: &mut R,
        now: MonotonicNs,
    ) -> Result<Supervisor<Armed>, Supervisor<Tripped>> {
        let checked = match rig.apply(now, self.limits.off()) {
            Err(fault) => Err(TripReason::Drive(fault)),
            Ok(()) => match rig.read(now) {
                Err(fault) => Err(TripReason::Sensor(fault)),
                Ok(reading) if !reading.value.is_finite() => Err(TripReason::Sensor(SensorFault::NotFinite)),
                Ok(_) => Ok(()),
            },
        };
        match checked {
            Ok(()) => Ok(self.with(Armed)),
            Err(reason) => Err(self.with(Tripped { reason })),
        }
    }

    /// The only voltage of this state: zero.
    #[must_use]
    pub fn voltage(&self) -> DriveVoltage {
        self.limits.off()
    }
}

impl Supervisor<Armed> {
    /// Starts a run whose first cycle is due at `now`.
    #[must_use]
    pub fn start(self, now: MonotonicNs) -> Supervisor<Running> {
        self.with(Running { last_cycle: now, over_limit_since: None })
    }

    /// Goes back without a run.
    #[must_use]
    pub fn disarm(self) -> Supervisor<Disarmed> {
        self.with(Disarmed)
    }

    /// The only voltage of this state: zero.
    #[must_use]
    pub fn voltage(&self) -> DriveVoltage {
        self.limits.off()
    }
}

impl Supervisor<Running> {
    /// Judges the time at which a cycle begins; to be called before the cycle.
    ///
    /// # Errors
    /// [`TripReason::CycleOverrun`] or [`TripReason::ClockStep`].
    pub fn check_deadline(&mut self, now: MonotonicNs) -> Result<(), TripReason> {
        let last = self.state.last_cycle;
        if now < last {
            return Err(TripReason::ClockStep { step_s: MonotonicNs(last.0 - now.0).seconds() });
        }
        let interval_s = MonotonicNs(now.0 - last.0).seconds();
        let allowed_s = self.settings.period_s + self.settings.overrun_tolerance_s;
        // Half a nanosecond for rounding to the clock's ticks.
        if interval_s > allowed_s + 0.5e-9 {
            return Err(TripReason::CycleOverrun { interval_s, allowed_s });
        }
        self.state.last_cycle = now;
        Ok(())
    }

    /// Judges what a cycle measured; to be called after it.
    ///
    /// # Errors
    /// [`TripReason::TrackingError`] once the error has stayed over its limit for longer than allowed.
    pub fn check_tracking(&mut self, now: MonotonicNs, output: &CycleOutput) -> Result<(), TripReason> {
        // Written so that NaN counts as over the limit.
        if output.error.abs() <= self.settings.error_limit {
            self.state.over_limit_since = None;
            return Ok(());
        }
        let since = *self.state.over_limit_since.get_or_insert(now);
        let over_s = MonotonicNs(now.0.saturating_sub(since.0)).seconds();
        if over_s <= self.settings.error_time_s {
            return Ok(());
        }
        Err(TripReason::TrackingError {
            error: output.error,
            limit: self.settings.error_limit,
            allowed_s: self.settings.error_time_s,
        })
    }

    /// Both checks for a cycle that began at `now` and produced `output`.
    ///
    /// # Errors
    /// The [`TripReason`] of the first check that failed.
    pub fn check(&mut self, now: MonotonicNs, output: &CycleOutput) -> Result<(), TripReason> {
        self.check_deadline(now)?;
        self.check_tracking(now, output)
    }

    /// One supervised cycle: deadline, [`cycle`], tracking error. On any trip zero volts is commanded and `control` latched.
    ///
    /// # Errors
    /// The [`TripReason`]; pass it to [`trip`](Self::trip).
    pub fn tick<R: Sensor + Drive>(
        &mut self,
        rig: &mut R,
        control: &mut ControlLoop,
        now: MonotonicNs,
        inputs: CycleInputs,
    ) -> Result<CycleOutput, TripReason> {
        if let Err(reason) = self.check_deadline(now) {
            return Err(control.trip(rig, now, reason));
        }
        let output = cycle(rig, control, now, inputs)?;
        match self.check_tracking(now, &output) {
            Ok(()) => Ok(output),
            Err(reason) => Err(control.trip(rig, now, reason)),
        }
    }

    /// Ends the run for `reason`. The caller commands [`Supervisor::<Tripped>::voltage`] unless [`tick`](Self::tick) has done so.
    #[must_use]
    pub fn trip(self, reason: TripReason) -> Supervisor<Tripped> {
        self.with(Tripped { reason })
    }

    /// Ends the run as planned. The caller commands [`Supervisor::<Disarmed>::voltage`].
    #[must_use]
    pub fn finish(self) -> Supervisor<Disarmed> {
        self.with(Disarmed)
    }
}

impl Supervisor<Tripped> {
    /// Why the run ended.
    #[must_use]
    pub fn reason(&self) -> TripReason {
        self.state.reason
    }

    /// The only voltage of this state: zero.
    #[must_use]
    pub fn voltage(&self) -> DriveVoltage {
        self.limits.off()
    }

    /// The operator has seen the reason; the rig must be armed again.
    #[must_use]
    pub fn acknowledge(self) -> Supervisor<Disarmed> {
        self.with(Disarmed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        AntiWindup, ControlLaw, ControlSettings, DriveFault, ErrorSign, FilterStart, InputLinearisation,
        Reading, SensorScale,
    };

    struct TestRig {
        reading: Result<Reading, SensorFault>,
        voltage_v: f64,
    }

    impl Sensor for TestRig {
        fn read(&mut self, _now: MonotonicNs) -> Result<Reading, SensorFault> {
            self.reading
        }
    }

    impl Drive for TestRig {
        fn apply(&mut self, _now: MonotonicNs, voltage: DriveVoltage) -> Result<(), DriveFault> {
            self.voltage_v = voltage.volts();
            Ok(())
        }
    }

    const SETTINGS: SupervisorSettings = SupervisorSettings {
        error_limit: 0.5,
        error_time_s: 0.01,
        period_s: 1e-3,
        overrun_tolerance_s: 1e-4,
    };

    fn limits() -> Limits {
        Limits::new(100.0, 5000.0, f64::INFINITY).expect("valid limits")
    }

    fn running(rig: &mut TestRig) -> Supervisor<Running> {
        let supervisor = Supervisor::new(SETTINGS, limits()).expect("valid settings");
        supervisor.arm(rig, MonotonicNs(0)).expect("rig is healthy").start(MonotonicNs(0))
    }

    fn control() -> ControlLoop {
        ControlLoop::new(ControlSettings {
            sample_time_s: 1e-3,
            sensor_scale: SensorScale::default(),
            measurement_filter: None,
            reference_filter: None,
            filter_start: FilterStart::AtFirstSample,
            law: ControlLaw::OpenLoop,
            error_sign: ErrorSign::Positive,
            trim: 0.5,
            linearisation: InputLinearisation::Identity,
            full_scale_v: 5000.0,
            limits: limits(),
            anti_windup: AntiWindup::None,
        })
        .expect("valid loop")
    }

    fn healthy() -> TestRig {
        TestRig { reading: Ok(Reading { value: 0.0 }), voltage_v: 9.0 }
    }

    #[test]
    fn edge_arming_checks_the_rig() {
        let mut rig = healthy();
        rig.reading = Err(SensorFault::Stale);
        let supervisor = Supervisor::new(SETTINGS, limits()).expect("valid settings");
        let tripped = supervisor.arm(&mut rig, MonotonicNs(0)).expect_err("sensor is stale");
        assert_eq!(tripped.reason(), TripReason::Sensor(SensorFault::Stale));
        assert_eq!((tripped.voltage().volts(), rig.voltage_v), (0.0, 0.0));
        rig.reading = Ok(Reading { value: 1.0 });
        assert!(tripped.acknowledge().arm(&mut rig, MonotonicNs(0)).is_ok());
    }

    #[test]
    fn edge_error_over_the_limit_trips_after_its_time_only() {
        let (mut rig, mut control) = (healthy(), control());
        let mut supervisor = running(&mut rig);
        let mut n_ok = 0;
        let mut trip = None;
        for k in 0..100_u64 {
            // Over the limit for 5 cycles, back for one, then for good.
            let reference = if k == 5 { 0.0 } else { 1.0 };
            let inputs = CycleInputs { reference, feedforward: 0.0 };
            match supervisor.tick(&mut rig, &mut control, MonotonicNs(k * 1_000_000), inputs) {
                Ok(_) => n_ok += 1,
                Err(reason) => {
                    trip = Some(reason);
                    break;
                }
            }
        }
        // Over since cycle 6; cycle 16 is exactly 10 ms later and still allowed; 17 is not.
        assert_eq!(n_ok, 17);
        let reason = trip.expect("must trip");
        assert_eq!(reason, TripReason::TrackingError { error: 1.0, limit: 0.5, allowed_s: 0.01 });
        assert_eq!((rig.voltage_v, control.tripped()), (0.0, Some(reason)));
        assert_eq!(supervisor.trip(reason).reason(), reason);
    }

    #[test]
    fn edge_late_cycle_and_clock_step_trip() {
        for (now, late) in [(2_200_000, true), (500_000, false)] {
            let (mut rig, mut control) = (healthy(), control());
            let mut supervisor = running(&mut rig);
            let inputs = CycleInputs { reference: 0.0, feedforward: 0.0 };
            assert!(supervisor.tick(&mut rig, &mut control, MonotonicNs(1_000_000), inputs).is_ok());
            assert_eq!(rig.voltage_v, 2500.0);
            let reason =
                supervisor.tick(&mut rig, &mut control, MonotonicNs(now), inputs).expect_err("must trip");
            assert_eq!(matches!(reason, TripReason::CycleOverrun { .. }), late);
            assert_eq!(matches!(reason, TripReason::ClockStep { .. }), !late);
            assert_eq!(rig.voltage_v, 0.0);
        }
    }

    #[test]
    fn edge_operator_stop_and_finish() {
        let mut rig = healthy();
        let tripped = running(&mut rig).trip(TripReason::OperatorStop);
        assert_eq!((tripped.reason(), tripped.voltage().volts()), (TripReason::OperatorStop, 0.0));
        assert_eq!(running(&mut rig).finish().voltage().volts(), 0.0);
    }

    #[test]
    fn edge_bad_settings_are_refused() {
        let without_limit = SupervisorSettings { error_limit: f64::INFINITY, ..SETTINGS };
        assert!(Supervisor::new(without_limit, limits()).is_ok());
        for bad in [
            SupervisorSettings { error_limit: f64::NAN, ..SETTINGS },
            SupervisorSettings { error_time_s: -1.0, ..SETTINGS },
            SupervisorSettings { period_s: 0.0, ..SETTINGS },
            SupervisorSettings { overrun_tolerance_s: f64::NAN, ..SETTINGS },
        ] {
            assert!(Supervisor::new(bad, limits()).is_err());
        }
    }
}
