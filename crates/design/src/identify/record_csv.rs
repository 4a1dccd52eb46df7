//! A sweep as text.

use super::record::{SweepPoint, SweepRecord};
use crate::{Error, Result};

/// The header of a sweep; columns may come in any order.
const HEADER: &str = "frequency_hz,amplitude,magnitude,phase_deg";
const COLUMNS: [&str; 4] = ["frequency_hz", "amplitude", "magnitude", "phase_deg"];

impl SweepRecord {
    /// Reads a sweep from text.
    ///
    /// **Shapes and units**: comment lines start with `#`; of these `# bias: 0.5` (fraction of full scale) and
    /// `# magnitude_unit: mm per unit` (the only unit allowed) are read, others are skipped. Then the header
    /// `frequency_hz,amplitude,magnitude,phase_deg`, then one point per line: Hz, fraction of full scale, mm per unit of
    /// full scale, degrees (lag is negative). Spaces, empty lines and a byte order mark are allowed.
    ///
    /// # Errors
    /// [`Error::SweepEmpty`], [`Error::SweepColumnMissing`], [`Error::SweepColumnUnknown`], [`Error::SweepFieldCount`],
    /// [`Error::SweepField`], [`Error::SweepDuplicate`], [`Error::SweepTooFewFrequencies`]; lines count from 1.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::identify::SweepRecord;
    /// let text = "frequency_hz,amplitude,magnitude,phase_deg\n1,0.2,0.95,-8\n2,0.2,1.0,-17\n4,0.2,1.4,-45\n\
    ///             6,0.2,2.1,-95\n12,0.2,0.3,-180\n";
    /// let record = SweepRecord::from_csv(text)?;
    /// assert_eq!(record.points()[3].magnitude_mm_per_unit, 2.1);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn from_csv(text: &str) -> Result<Self> {
        let mut bias = None;
        let mut order = None;
        let mut points = Vec::new();
        let mut lines = Vec::new();
        for (line_idx, raw) in text.trim_start_matches('\u{feff}').lines().enumerate() {
            let (line, content) = (line_idx + 1, raw.trim());
            if content.is_empty() {
                continue;
            }
            if let Some(comment) = content.strip_prefix('#') {
                read_comment(comment, line, &mut bias)?;
                continue;
            }
            let fields: Vec<&str> = content.split(',').map(str::trim).collect();
            match order {
                None => order = Some(column_order(&fields, content, line)?),
                Some(order) => {
                    points.push(read_point(&fields, order, line)?);
                    lines.push(line);
                }
            }
        }
        if order.is_none() {
            return Err(Error::SweepEmpty { expected: HEADER });
        }
        Self::with_lines(points, bias, &lines)
    }

    /// Writes the sweep as text; [`from_csv`](Self::from_csv) reads it back bit for bit, except for the distortion,
    /// which the format has no column for.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = String::from("# magnitude_unit: mm per unit\n");
        if let Some(bias) = self.bias() {
            text.push_str(&format!("# bias: {bias}\n"));
        }
        text.push_str(HEADER);
        text.push('\n');
        for p in self.points() {
            let SweepPoint { frequency_hz, amplitude, magnitude_mm_per_unit, phase_deg, .. } = p;
            text.push_str(&format!("{frequency_hz},{amplitude},{magnitude_mm_per_unit},{phase_deg}\n"));
        }
        text
    }
}

/// For each of [`COLUMNS`], where it stands in the file.
fn column_order(fields: &[&str], header: &str, line: usize) -> Result<[usize; 4]> {
    let mut order = [0; 4];
    for (place, column) in order.iter_mut().zip(COLUMNS) {
        *place = fields.iter().position(|f| *f == column).ok_or_else(|| Error::SweepColumnMissing {
            line,
            column,
            found: header.to_string(),
            expected: HEADER,
        })?;
    }
    match (0..fields.len()).find(|place| !order.contains(place)) {
        Some(extra) => {
            Err(Error::SweepColumnUnknown { line, found: fields[extra].to_string(), expected: HEADER })
        }
        None => Ok(order),
    }
}

fn read_point(fields: &[&str], order: [usize; 4], line: usize) -> Result<SweepPoint> {
    if fields.len() != COLUMNS.len() {
        return Err(Error::SweepFieldCount { line, expected: COLUMNS.len(), found: fields.len() });
    }
    let number = |column_idx: usize| {
        let found = fields[order[column_idx]];
        found.parse::<f64>().map_err(|_| Error::SweepField {
            line,
            column: COLUMNS[column_idx],
            found: found.to_string(),
            allowed: "a number",
        })
    };
    Ok(SweepPoint {
        frequency_hz: number(0)?,
        amplitude: number(1)?,
        magnitude_mm_per_unit: number(2)?,
        phase_deg: number(3)?,
        distortion: None,
    })
}

fn read_comment(comment: &str, line: usize, bias: &mut Option<f64>) -> Result<()> {
    let Some((key, value)) = comment.split_once(':') else { return Ok(()) };
    let found = value.trim();
    let refuse = |column, allowed| Err(Error::SweepField { line, column, found: found.to_string(), allowed });
    match key.trim() {
        "bias" => match found.parse::<f64>() {
            Ok(b) if (0.0..=1.0).contains(&b) => *bias = Some(b),
            _ => return refuse("bias", "a number from 0 to 1"),
        },
        "magnitude_unit" if found != "mm per unit" => return refuse("magnitude_unit", "`mm per unit`"),
        _ => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "# magnitude_unit: mm per unit\n# bias: 0.5\n# rig: bench 2\n\
        frequency_hz,amplitude,magnitude,phase_deg\n\
        0.1,0.2,0.95,-1\n1,0.2,0.96,-8\n2,0.2,1.0,-17\n4,0.2,1.4,-45\n6,0.2,2.1,-95\n12,0.2,0.3,-180\n";

    fn refused(text: &str) -> String {
        SweepRecord::from_csv(text).expect_err("must be refused").to_string()
    }

    #[test]
    fn law_text_round_trip_is_bit_for_bit() {
        let mut points: Vec<SweepPoint> = Vec::new();
        for k in 0..40_u32 {
            // Numbers without a short decimal form.
            let x = f64::from(k) + 1.0 / 3.0;
            points.push(SweepPoint {
                frequency_hz: 0.1 * x,
                amplitude: 0.2 + 0.1 / x.sqrt(),
                magnitude_mm_per_unit: 1.0 / x,
                phase_deg: -7.0 * x,
                distortion: None,
            });
        }
        let record = SweepRecord::new(points, Some(0.1 + 0.2)).expect("valid");
        assert_eq!(SweepRecord::from_csv(&record.to_csv()), Ok(record));
    }

    #[test]
    fn edge_header_order_spaces_and_byte_order_mark_do_not_matter() {
        let shuffled = "\u{feff}phase_deg, frequency_hz ,magnitude,amplitude\r\n-8, 1, 0.96 ,0.2\r\n\r\n-9,2,1,.2\n-10,3,1,0.2\n-1,4,1,0.2\n-1,5,1,0.2";
        let record = SweepRecord::from_csv(shuffled).expect("valid");
        assert_eq!(record.points()[0].phase_deg, -8.0);
        assert_eq!(record.points()[0].frequency_hz, 1.0);
        assert_eq!(record.points().len(), 5);
        assert_eq!(SweepRecord::from_csv(GOOD).expect("valid").bias(), Some(0.5));
    }

    #[test]
    fn edge_bad_text_is_refused_by_line_and_column() {
        assert!(refused("").contains("found an empty file"));
        assert!(refused("# bias: 0.5\n").contains("found an empty file"));
        let missing = refused(&GOOD.replace(",phase_deg", ",phase"));
        assert!(missing.starts_with("line 4: column `phase_deg` is missing"), "{missing}");
        let extra = refused(&GOOD.replace(",phase_deg", ",phase_deg,gain"));
        assert!(extra.starts_with("line 4: column `gain` is unknown"), "{extra}");
        let text = refused(&GOOD.replace("0.96", "abc"));
        assert_eq!(text, "line 6, column `magnitude`: allowed is a number, found `abc`");
        let nan = refused(&GOOD.replace("0.96", "NaN"));
        assert_eq!(nan, "line 6, column `magnitude`: allowed is a number above 0, found `NaN`");
        let negative = refused(&GOOD.replace("\n2,", "\n-2,"));
        assert_eq!(negative, "line 7, column `frequency_hz`: allowed is a number above 0, found `-2`");
        let short = refused(&GOOD.replace("1.4,-45", "1.4"));
        assert_eq!(short, "line 8: expected 4 fields, found 3");
        let twice = refused(&GOOD.replace("\n2,", "\n1,"));
        assert!(twice.starts_with("line 7: 1 Hz at amplitude 0.2 was given before in line 6"), "{twice}");
        assert!(refused(&GOOD.replace("mm per unit", "um/V")).contains("`mm per unit`"));
        assert!(refused(&GOOD.replace("bias: 0.5", "bias: 5")).contains("a number from 0 to 1"));
        let few = refused("frequency_hz,amplitude,magnitude,phase_deg\n1,0.2,1,0\n1,0.4,1,0\n");
        assert!(few.contains("at least 5 different frequencies, found 1"));
    }
}
