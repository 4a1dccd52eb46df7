//! Real recordings: those of the folder `../shared/data/pulse` beside the checkout. Without that folder the
//! tests say so and pass.

// A skipped test must say so.
#![allow(clippy::print_stderr)]

use std::fs::File;
use std::path::{Path, PathBuf};

use telepulse_pulse::fidelity::{self, LagSearch};
use telepulse_pulse::spectrum::{Spectrum, Window};
use telepulse_pulse::{PulseRecording, beats, formats, resample};

/// A row of `manifest.csv`.
struct Entry {
    name: String,
    kind: String,
    sample_rate_hz: f64,
    n_beats: usize,
    heart_rate_bpm: f64,
}

fn folder() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/pulse");
    if folder.join("manifest.csv").is_file() {
        return Some(folder);
    }
    eprintln!("skipped: {} is not there", folder.display());
    None
}

fn manifest(folder: &Path) -> Vec<Entry> {
    let mut reader = csv::Reader::from_path(folder.join("manifest.csv")).expect("manifest opens");
    let header = reader.headers().expect("manifest has a header").clone();
    let column = |name: &str| header.iter().position(|h| h == name).expect("manifest has the column");
    let (name, kind, rate) = (column("name"), column("kind"), column("fs_hz"));
    let (n_beats, heart_rate) = (column("beats"), column("hr_bpm"));
    let entry = |row: csv::StringRecord| Entry {
        name: row[name].to_owned(),
        kind: row[kind].to_owned(),
        sample_rate_hz: row[rate].parse().expect("a rate"),
        n_beats: row[n_beats].parse().expect("a count"),
        heart_rate_bpm: row[heart_rate].parse().expect("a rate"),
    };
    reader.records().map(|row| entry(row.expect("a row"))).collect()
}

fn read(folder: &Path, name: &str) -> PulseRecording {
    let file = File::open(folder.join(format!("{name}.csv"))).expect("recording opens");
    formats::csv::read(file).expect("recording is valid")
}

#[test]
fn oracle_rates_of_all_recordings_agree_with_the_manifest() {
    let Some(folder) = folder() else { return };
    for entry in manifest(&folder) {
        let found = read(&folder, &entry.name).sample_rate_hz();
        // Two recordings of 125.002 Hz carry stamps of exactly 125 Hz; their true rate is in the manifest
        // alone.
        let tolerance = if entry.sample_rate_hz == 125.002 { 0.0021 } else { 0.0 };
        assert!((found - entry.sample_rate_hz).abs() <= tolerance, "{}: {found}", entry.name);
    }
}

#[test]
fn oracle_beats_of_all_recordings_agree_with_the_manifest() {
    let Some(folder) = folder() else { return };
    for entry in manifest(&folder) {
        let train = beats::detect(&read(&folder, &entry.name)).expect("beats");
        // One beat more or less: records that begin at a peak do not show its foot.
        let count = train.beats.len();
        assert!(count.abs_diff(entry.n_beats) <= 1, "{}: {count} of {} beats", entry.name, entry.n_beats);
        let difference = (train.heart_rate_bpm - entry.heart_rate_bpm).abs();
        assert!(difference < 1.5, "{}: {} of {} bpm", entry.name, train.heart_rate_bpm, entry.heart_rate_bpm);
        assert!(
            train.beats.iter().all(|beat| beat.foot_s < beat.peak_s && beat.foot_value < beat.peak_value)
        );
        if entry.kind.starts_with("arterial pressure") {
            let n_good = train.beats.iter().filter(|beat| beat.is_good()).count();
            assert!(n_good + 1 >= count, "{}: only {n_good} of {count} beats are good", entry.name);
        }
    }
}

#[test]
fn oracle_the_strongest_component_lies_at_the_heart_rate() {
    let Some(folder) = folder() else { return };
    let recording = read(&folder, "or_abp_40s");
    let spectrum = Spectrum::of(recording.values(), recording.sample_rate_hz(), Window::Hann).expect("valid");
    let peaks = spectrum.peaks(0.0);
    let from_half_hertz = peaks.iter().filter(|peak| peak.frequency_hz > 0.5);
    let strongest = from_half_hertz.max_by(|a, b| a.amplitude.total_cmp(&b.amplitude)).expect("a peak");
    // 78.4 beats per minute in the manifest; the rate varies by 3.8 %.
    assert!((60.0 * strongest.frequency_hz - 78.4).abs() < 0.04 * 78.4, "{strongest:?}");
}

#[test]
fn law_files_survive_reading_and_writing() {
    let Some(folder) = folder() else { return };
    for entry in manifest(&folder) {
        let recording = read(&folder, &entry.name);
        let mut bytes = Vec::new();
        formats::csv::write(&recording, &mut bytes).expect("memory does not fail");
        assert_eq!(formats::csv::read(bytes.as_slice()).expect("reads back"), recording, "{}", entry.name);
    }
}

#[test]
fn law_a_delayed_real_pulse_shows_its_delay() {
    let Some(folder) = folder() else { return };
    let fine = resample::resample(&read(&folder, "or_abp_40s"), 2000.0).expect("valid");
    // The same curve 77 samples later.
    let (reference, output) = (&fine.values()[77..], &fine.values()[..fine.n_samples() - 77]);
    let fidelity = fidelity::compare(reference, output, 2000.0, LagSearch::default()).expect("comparable");
    assert!((fidelity.lag_ms - 38.5).abs() < 0.005, "{fidelity:?}");
    assert!(fidelity.nrmse > 0.1 && fidelity.nrmse_aligned < 1e-4, "{fidelity:?}");
}
