//! Files the program writes: whole or not at all.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use sha2::{Digest, Sha256};

/// Writes a file under a temporary name beside its place, then moves it there.
///
/// # Errors
/// Names the file where it cannot be written; then nothing is left behind.
pub fn write_file(path: &Path, content: &[u8]) -> Result<()> {
    let mut file = GrowingFile::beside(path)?;
    file.write_all(content).with_context(|| format!("cannot write {}", path.display()))?;
    file.commit()
}

/// A file that appears under its name only once it is complete. Dropped before, it leaves nothing behind.
#[derive(Debug)]
pub struct GrowingFile {
    target: PathBuf,
    partial: PathBuf,
    file: fs::File,
    folder: MadeFolder,
    committed: bool,
}

impl GrowingFile {
    /// Opens the file under a temporary name beside `target`; folders on the way to it are made.
    ///
    /// # Errors
    /// Names the file or folder that cannot be made, or `target` where that is a folder.
    pub fn beside(target: &Path) -> Result<Self> {
        ensure!(!target.is_dir(), "cannot write {}: it is a folder", target.display());
        let name = target.file_name().with_context(|| format!("{} names no file", target.display()))?;
        let folder = MadeFolder::make(target.parent().unwrap_or(Path::new("")))?;
        let mut name = name.to_os_string();
        name.push(format!(".partial-{}", std::process::id()));
        let partial = target.with_file_name(name);
        let file =
            fs::File::create(&partial).with_context(|| format!("cannot write {}", target.display()))?;
        Ok(Self { target: target.to_path_buf(), partial, file, folder, committed: false })
    }

    /// Gives the file its name; an older one of that name is replaced.
    ///
    /// # Errors
    /// Names the file; then nothing is left behind.
    pub fn commit(self) -> Result<()> {
        let target = self.target.clone();
        self.commit_as(&target)
    }

    /// Gives the file another name than the one it was begun for, in the same folder.
    ///
    /// # Errors
    /// Names the file; then nothing is left behind.
    pub fn commit_as(mut self, target: &Path) -> Result<()> {
        fs::rename(&self.partial, target).with_context(|| format!("cannot write {}", target.display()))?;
        self.committed = true;
        self.folder.keep();
        Ok(())
    }
}

impl Write for GrowingFile {
    fn write(&mut self, content: &[u8]) -> std::io::Result<usize> {
        self.file.write(content)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

impl Drop for GrowingFile {
    fn drop(&mut self) {
        if !self.committed {
            let _ = fs::remove_file(&self.partial);
        }
    }
}

/// A folder, made with those above it; what was made is taken away again unless it is kept.
#[derive(Debug, Default)]
struct MadeFolder {
    /// Outermost first.
    made: Vec<PathBuf>,
}

impl MadeFolder {
    fn make(folder: &Path) -> Result<Self> {
        let missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
        let mut made: Vec<PathBuf> = folder.ancestors().take_while(missing).map(Path::to_path_buf).collect();
        made.reverse();
        let made = Self { made };
        if !folder.as_os_str().is_empty() {
            fs::create_dir_all(folder).with_context(|| format!("cannot make folder {}", folder.display()))?;
        }
        Ok(made)
    }

    fn keep(&mut self) {
        self.made.clear();
    }
}

impl Drop for MadeFolder {
    fn drop(&mut self) {
        // Only empty folders go: one into which somebody else has written meanwhile stays.
        for folder in self.made.iter().rev() {
            let _ = fs::remove_dir(folder);
        }
    }
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
    parent: MadeFolder,
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
        let parent = MadeFolder::make(target.parent().unwrap_or(Path::new("")))?;
        fs::create_dir_all(&staged).with_context(|| format!("cannot make folder {}", staged.display()))?;
        Ok(Self { staged, target: target.to_path_buf(), parent, committed: false })
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
        self.parent.keep();
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

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .expect("readable")
            .map(|entry| entry.expect("readable").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn edge_what_is_given_up_leaves_nothing() {
        let bench = tempfile::tempdir().expect("a temporary folder");
        let mut file = GrowingFile::beside(&bench.path().join("a/b/file.csv")).expect("can be made");
        file.write_all(b"half").expect("can be written");
        assert_eq!(names(&bench.path().join("a/b")).len(), 1);
        drop(file);
        let folder = StagedFolder::beside(&bench.path().join("c/d/results")).expect("can be made");
        fs::write(folder.path().join("x"), "x").expect("can be written");
        drop(folder);
        assert!(names(bench.path()).is_empty());
    }

    #[test]
    fn edge_a_file_that_cannot_be_replaced_leaves_nothing() {
        let bench = tempfile::tempdir().expect("a temporary folder");
        fs::create_dir(bench.path().join("taken")).expect("can be made");
        let error = write_file(&bench.path().join("taken"), b"x").expect_err("a folder stands there");
        assert!(error.to_string().contains("taken: it is a folder"), "{error}");
        assert_eq!(names(bench.path()), ["taken"]);
    }

    #[test]
    fn law_results_replace_only_results() {
        let bench = tempfile::tempdir().expect("a temporary folder");
        let target = bench.path().join("made/results");
        for run in ["first", "second"] {
            let folder = StagedFolder::beside(&target).expect("may be replaced");
            fs::write(folder.path().join(MARK), run).expect("can be written");
            folder.commit().expect("can be named");
        }
        assert_eq!(fs::read_to_string(target.join(MARK)).expect("readable"), "second");
        assert_eq!(names(&bench.path().join("made")), ["results"]);
        fs::remove_file(target.join(MARK)).expect("removed");
        fs::write(target.join("note"), "mine").expect("can be written");
        assert!(StagedFolder::beside(&target).is_err());
        assert_eq!(names(&bench.path().join("made")), ["results"]);
    }
}
