//! Adds keys to the report of a study that has run.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use serde_json::{Map, Value};

use crate::artefact;

/// Puts `value` under `key` into the folder's `report.json`, replacing what stood there; every other key stays as it is. Where no study has
/// run into the folder, the file is begun.
///
/// # Errors
/// Where the file is no JSON object or cannot be written.
pub fn amend<T: Serialize>(folder: &Path, key: &str, value: &T) -> Result<PathBuf> {
    let path = folder.join("report.json");
    let mut report = if path.is_file() {
        serde_json::from_str(&artefact::read_text(&path)?)
            .with_context(|| format!("in {}", path.display()))?
    } else {
        Value::Object(Map::new())
    };
    ensure!(report.is_object(), "{} holds no JSON object", path.display());
    report[key] = serde_json::to_value(value)?;
    let mut text = serde_json::to_vec_pretty(&report)?;
    text.push(b'\n');
    artefact::write_file(&path, &text)?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_other_keys_stay_and_a_missing_file_is_begun() {
        let folder = tempfile::tempdir().expect("a folder");
        amend(folder.path(), "first", &1).expect("begun");
        amend(folder.path(), "second", &[0.5]).expect("added");
        let path = amend(folder.path(), "first", &2).expect("replaced");
        let found: Value = serde_json::from_str(&artefact::read_text(&path).expect("reads")).expect("JSON");
        assert_eq!(found, serde_json::json!({ "first": 2, "second": [0.5] }));
        artefact::write_file(&path, b"[1]").expect("written");
        assert!(amend(folder.path(), "x", &1).expect_err("a list").to_string().contains("no JSON object"));
    }
}
