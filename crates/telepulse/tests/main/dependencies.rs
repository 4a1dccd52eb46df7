//! The dependency table of ARCHITECTURE.md, enforced.

use cargo_metadata::{DependencyKind, MetadataCommand};

/// Crate, what it may use inside of the workspace, and what it must not use from outside.
const TABLE: [(&str, &[&str], &[&str]); 7] = [
    ("telepulse-lti", &[], &["clap", "indicatif"]),
    ("telepulse-rt", &[], &["nalgebra", "serde", "rayon", "num-complex"]),
    ("telepulse-pulse", &[], &["nalgebra"]),
    ("telepulse-actuator", &["telepulse-lti", "telepulse-rt"], &[]),
    ("telepulse-design", &["telepulse-lti"], &[]),
    ("telepulse-link", &["telepulse-pulse"], &["nalgebra"]),
    (
        "telepulse",
        &[
            "telepulse-lti",
            "telepulse-rt",
            "telepulse-pulse",
            "telepulse-actuator",
            "telepulse-design",
            "telepulse-link",
        ],
        &[],
    ),
];

#[test]
fn law_crates_use_only_what_the_table_allows() {
    let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/../../Cargo.toml");
    let metadata = MetadataCommand::new()
        .manifest_path(manifest)
        .no_deps()
        .exec()
        .expect("cargo metadata describes the workspace");
    let mut seen = 0;
    for package in &metadata.packages {
        let (_, may_use, must_not) = TABLE
            .iter()
            .find(|(name, _, _)| *name == package.name.as_str())
            .unwrap_or_else(|| panic!("crate {} is not in the dependency table", package.name));
        seen += 1;
        // Development dependencies count as well: a test that sees the actuator would teach the design its answers.
        for dependency in &package.dependencies {
            if dependency.name.starts_with("telepulse") {
                assert!(
                    may_use.contains(&dependency.name.as_str()),
                    "{} uses {}, which the table does not allow",
                    package.name,
                    dependency.name
                );
            }
            assert!(
                dependency.kind != DependencyKind::Normal || !must_not.contains(&dependency.name.as_str()),
                "{} uses {}, which the table forbids",
                package.name,
                dependency.name
            );
        }
    }
    assert_eq!(seen, TABLE.len(), "a crate of the table is missing from the workspace");
}

#[test]
fn law_rt_is_built_without_the_standard_library() {
    let source = include_str!("../../../rt/src/lib.rs");
    assert!(source.contains("#![no_std]"), "crates/rt/src/lib.rs has lost #![no_std]");
    assert!(!source.contains("extern crate alloc"), "crates/rt must not allocate");
}
