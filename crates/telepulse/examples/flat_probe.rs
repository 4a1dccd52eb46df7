use telepulse::station::{device, replay};
use telepulse::study::{config::Study, models, recipes};
fn main() -> anyhow::Result<()> {
    let mut study = Study::load(std::path::Path::new("studies/diaphragm-2017"))?;
    let twin = device::twin(&study)?;
    let t = std::time::Instant::now();
    let m = models::measure(&study, &twin, &|| ())?;
    println!("{:?} {:#?}", t.elapsed(), m.motion);
    study.pulse.playout_delay_s = 0.25;
    let r = recipes::build(&study, &m)?;
    let best = &r.displacement.iter().find(|(n, _)| n == "best").unwrap().1;
    use telepulse_design::implement::*;
    for (h, bw, past) in [(0.2, 45., 0.25), (0.2, 60., 0.15), (0.1, 60., 0.15), (0.04, 60., 0.15)] {
        let t = std::time::Instant::now();
        let ts = telepulse_lti::SampleTime::new(study.sample_time_s())?;
        let flat = FlatFeedforward::new(
            &m.motion.model,
            ts,
            &SmootherOptions { horizon_s: h, bandwidth_hz: bw, past_s: past, ..SmootherOptions::default() },
            best.settings().flat_drive(),
        )?;
        println!(
            "horizon {h} bw {bw} expected {:.2e} build {:?}",
            flat.smoother().expected_error.sqrt(),
            t.elapsed()
        );
        let recipe = &best.with_feedforward(Some(Feedforward::Flat(Box::new(flat))))?;
        for e in std::fs::read_dir("/work/shared/data/pulse")? {
            let p = e?.path();
            let name = p.file_stem().unwrap().to_string_lossy().into_owned();
            if name == "manifest" {
                continue;
            }
            let rec = telepulse::recording::read(&p)?;
            if rec.unit().symbol() != "mmHg" {
                continue;
            }
            let rec = telepulse::recording::as_pressure(&rec, study.pulse.peak_to_peak_pa)?;
            let out = replay::replay(&study, &twin, "best", recipe, &rec, replay::Mode::Displacement)?;
            println!(
                "   {name:16} lag {:.3} nrmse {:.5} aligned {:.5} v {:?} {:?} {:?}",
                out.result.lag_ms.unwrap_or(f64::NAN),
                out.result.nrmse.unwrap_or(f64::NAN),
                out.result.nrmse_aligned.unwrap_or(f64::NAN),
                out.result.min_voltage_v,
                out.result.max_voltage_v,
                out.result.unstable_reason
            );
        }
    }
    Ok(())
}
