//! Files the program writes: whole or not at all.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use sha2::{Digest, Sha256};

/// Writes a file under a temporary name beside its place, then moves it there.
///
/// # Errors
/// Names the file where it cannot be written; then nothing is left behind.
pub fn write_file(path: &Path, content: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).with_context(|| format!("cannot make folder {}", folder.display()))?;
    }
    let mut name =
        path.file_name().with_context(|| format!("{} names no file", path.display()))?.to_os_string();
    name.push(format!(".partial-{}", std::process::id()));
    let partial = path.with_file_name(name);
    let written = fs::write(&partial, content).and_then(|()| fs::rename(&partial, path));
    if written.is_err() {
        let _ = fs::remove_file(&partial);
    }
    written.with_context(|| format!("cannot write {}", path.display()))
}

/// Reads a text file.
///
/// # Errors
/// Names the file.
pub fn read_text(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// SHA-256 of a file in hexadecimal.
///
/// # Errors
/// Names the file.
pub fn sha256_of(path: &Path) -> Result<String> {
    let content = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(Sha256::digest(&content).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Marks a folder as one that this program made, so that only such a folder is ever replaced.
const MARK: &str = "report.json";

/// A results folder that appears under its name only once it is complete.
#[derive(Debug)]
pub struct StagedFolder {
    staged: PathBuf,
    target: PathBuf,
    committed: bool,
}

impl StagedFolder {
    /// Makes the hidden folder in which the results grow, beside `target`.
    ///
    /// # Errors
    /// Where `target` is something else than a results folder (it would be replaced), or nothing can be written beside it.
    pub fn beside(target: &Path) -> Result<Self> {
        if target.exists() {
            ensure!(
                target.join(MARK).is_file()
                    || fs::read_dir(target).is_ok_and(|mut entries| entries.next().is_none()),
                "{} exists and holds no {MARK}: it is no results folder and is left alone",
                target.display()
            );
        }
        let name = target.file_name().with_context(|| format!("{} names no folder", target.display()))?;
        let staged =
            target.with_file_name(format!(".{}.partial-{}", name.to_string_lossy(), std::process::id()));
        fs::create_dir_all(&staged).with_context(|| format!("cannot make folder {}", staged.display()))?;
        Ok(Self { staged, target: target.to_path_buf(), committed: false })
    }

    /// Where to write.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.staged
    }

    /// Gives the folder its name; an older one of that name is replaced.
    ///
    /// # Errors
    /// Where the old folder cannot be moved away or the new one not be named; then the old one stays.
    pub fn commit(mut self) -> Result<PathBuf> {
        let old = self.staged.with_extension("old");
        let had_old = self.target.exists();
        if had_old {
            fs::rename(&self.target, &old)
                .with_context(|| format!("cannot replace {}", self.target.display()))?;
        }
        if let Err(error) = fs::rename(&self.staged, &self.target) {
            if had_old {
                let _ = fs::rename(&old, &self.target);
            }
            bail!("cannot name {}: {error}", self.target.display());
        }
        self.committed = true;
        if had_old {
            let _ = fs::remove_dir_all(&old);
        }
        Ok(self.target.clone())
    }
}

impl Drop for StagedFolder {
    fn drop(&mut self) {
        if !self.committed {
            let _ = fs::remove_dir_all(&self.staged);
        }
    }
}
