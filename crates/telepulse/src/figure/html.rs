//! The self-contained report page: text, tables and figures in one file that opens without a network.

use std::fmt::Write as _;

use super::text::{escape, number};
use super::{Figure, plotly, svg};

/// A report page under construction: each call adds to the end of the current section.
///
/// All text is plain and is escaped. Figures are interactive on screen; on paper, and where scripts are off,
/// their static drawing takes their place.
///
/// **Example**
/// ```
/// use telepulse::figure::{Cell, ReportPage, Table};
/// let gain = [Cell::text("DC gain, mm/unit"), Cell::number(0.935, 4)];
/// let page = ReportPage::new("Report")
///     .section("Plant")
///     .paragraph("Gain < 1 & stable.")
///     .table(Table::new("Identified", ["item", "value"]).row(gain))
///     .render();
/// assert!(page.contains("Gain &lt; 1 &amp; stable.") && page.contains("0.9350"));
/// ```
#[derive(Debug, Clone)]
pub struct ReportPage {
    title: String,
    subtitle: String,
    summary: Vec<SummaryRow>,
    contents: Vec<Heading>,
    body: String,
    n_figures: usize,
    n_tables: usize,
    footer: String,
}

/// A table with a caption.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// What the table shows.
    pub caption: String,
    /// Column headings with units.
    pub header: Vec<String>,
    /// Rows; each has as many cells as the header.
    pub rows: Vec<Vec<Cell>>,
}

/// A cell of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cell {
    /// Plain text, left-aligned.
    Text(String),
    /// A formatted number, right-aligned.
    Number(String),
    /// The outcome of a check.
    Status(Status, String),
    /// Nothing to show.
    Empty,
}

/// The outcome of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Met.
    Pass,
    /// Not met.
    Fail,
    /// Neither: to be known.
    Note,
}

#[derive(Debug, Clone)]
struct SummaryRow {
    label: String,
    value: String,
    status: Option<Status>,
}

#[derive(Debug, Clone)]
struct Heading {
    text: String,
    level: Level,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Level {
    Section,
    Subsection,
}

impl Cell {
    /// A text cell.
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// A number with this many significant digits; `n/a` if it is not finite.
    pub fn number(value: f64, significant_digits: usize) -> Self {
        Self::Number(number(value, significant_digits))
    }

    /// A whole number.
    pub fn count(count: u64) -> Self {
        Self::Number(count.to_string())
    }

    /// A number, or an empty cell.
    pub fn optional(value: Option<f64>, significant_digits: usize) -> Self {
        value.map_or(Self::Empty, |value| Self::number(value, significant_digits))
    }

    /// `text`, marked as met or not met.
    pub fn check(status: Status, text: impl Into<String>) -> Self {
        Self::Status(status, text.into())
    }
}

impl Table {
    /// A table without rows.
    pub fn new<H: Into<String>>(caption: impl Into<String>, header: impl IntoIterator<Item = H>) -> Self {
        Self {
            caption: caption.into(),
            header: header.into_iter().map(Into::into).collect(),
            rows: Vec::new(),
        }
    }

    /// The table with one more row.
    ///
    /// **Panics** if the row has not as many cells as the header.
    pub fn row(mut self, cells: impl IntoIterator<Item = Cell>) -> Self {
        let cells: Vec<Cell> = cells.into_iter().collect();
        assert_eq!(
            cells.len(),
            self.header.len(),
            "table `{}`: cells per row and columns differ",
            self.caption
        );
        self.rows.push(cells);
        self
    }

    fn render(&self, table_number: usize) -> String {
        // A column is aligned as a whole, heading included: to the right if it holds numbers and no text.
        let is_numeric = |column: usize| {
            let mut cells =
                self.rows.iter().filter_map(|row| row.get(column)).filter(|c| **c != Cell::Empty).peekable();
            cells.peek().is_some() && cells.all(|cell| matches!(cell, Cell::Number(_)))
        };
        let mut html = format!(
            "<div class=\"table\"><table>\n<caption><b>Table {table_number}.</b> {}</caption>\n<thead><tr>",
            escape(&self.caption)
        );
        for (column, heading) in self.header.iter().enumerate() {
            let class = if is_numeric(column) { " class=\"n\"" } else { "" };
            let _ = write!(html, "<th scope=\"col\"{class}>{}</th>", escape(heading));
        }
        html.push_str("</tr></thead>\n<tbody>\n");
        for row in &self.rows {
            html.push_str("<tr>");
            for cell in row {
                html.push_str(&cell.render());
            }
            html.push_str("</tr>\n");
        }
        html.push_str("</tbody></table></div>\n");
        html
    }
}

impl Cell {
    fn render(&self) -> String {
        match self {
            Self::Text(text) => format!("<td>{}</td>", escape(text)),
            Self::Number(text) => format!("<td class=\"n\">{}</td>", escape(text)),
            Self::Status(status, text) => format!("<td>{}</td>", status.badge(text)),
            Self::Empty => "<td></td>".to_owned(),
        }
    }
}

impl Status {
    /// The text with a mark that does not rely on colour alone.
    fn badge(self, text: &str) -> String {
        let (class, mark) = match self {
            Self::Pass => ("pass", "\u{2713}"),
            Self::Fail => ("fail", "\u{2717}"),
            Self::Note => ("note", "\u{2022}"),
        };
        format!("<span class=\"{class}\">{mark} {}</span>", escape(text))
    }
}

impl ReportPage {
    /// An empty page.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            subtitle: String::new(),
            summary: Vec::new(),
            contents: Vec::new(),
            body: String::new(),
            n_figures: 0,
            n_tables: 0,
            footer: String::new(),
        }
    }

    /// The page with a line below its title.
    pub fn subtitle(mut self, subtitle: impl Into<String>) -> Self {
        self.subtitle = subtitle.into();
        self
    }

    /// The page with one more line in the box at its top.
    pub fn summary(
        mut self,
        label: impl Into<String>,
        value: impl Into<String>,
        status: Option<Status>,
    ) -> Self {
        self.summary.push(SummaryRow { label: label.into(), value: value.into(), status });
        self
    }

    /// The page with a new section, listed in the table of contents.
    pub fn section(self, heading: impl Into<String>) -> Self {
        self.heading(heading.into(), Level::Section)
    }

    /// The page with a new part of the current section, listed in the table of contents.
    pub fn subsection(self, heading: impl Into<String>) -> Self {
        self.heading(heading.into(), Level::Subsection)
    }

    /// The page with one more paragraph.
    pub fn paragraph(mut self, text: impl AsRef<str>) -> Self {
        let _ = writeln!(self.body, "<p>{}</p>", escape(text.as_ref()));
        self
    }

    /// The page with a remark that stands out: an assumption, a limit, a warning.
    pub fn note(mut self, text: impl AsRef<str>) -> Self {
        let _ = writeln!(self.body, "<aside>{}</aside>", escape(text.as_ref()));
        self
    }

    /// The page with a bulleted list.
    pub fn list<T: AsRef<str>>(mut self, items: impl IntoIterator<Item = T>) -> Self {
        self.body.push_str("<ul>\n");
        for item in items {
            let _ = writeln!(self.body, "<li>{}</li>", escape(item.as_ref()));
        }
        self.body.push_str("</ul>\n");
        self
    }

    /// The page with text whose line breaks and spaces are kept: formulas, commands, files.
    pub fn preformatted(mut self, text: impl AsRef<str>) -> Self {
        let _ = writeln!(self.body, "<pre>{}</pre>", escape(text.as_ref()));
        self
    }

    /// The page with one more numbered table.
    pub fn table(mut self, table: Table) -> Self {
        self.n_tables += 1;
        self.body.push_str(&table.render(self.n_tables));
        self
    }

    /// The page with one more numbered figure.
    pub fn figure(mut self, figure: &Figure) -> Self {
        self.n_figures += 1;
        let _ = write!(
            self.body,
            "<figure id=\"{}\">\n<div class=\"interactive\">{}</div>\n<div class=\"static\">{}</div>\n\
             <figcaption><b>Figure {}. {}</b> {}</figcaption>\n</figure>\n",
            figure.id(),
            plotly::fragment(figure),
            svg::render(figure),
            self.n_figures,
            escape(&figure.title),
            escape(&figure.caption),
        );
        self
    }

    /// The page with this line at its foot: program version, input hashes, seed.
    pub fn footer(mut self, text: impl Into<String>) -> Self {
        self.footer = text.into();
        self
    }

    /// The page as one HTML document.
    pub fn render(&self) -> String {
        let script = if self.n_figures > 0 { plotly::head_script() } else { String::new() };
        let mut html = String::with_capacity(script.len() + self.body.len() + 16_384);
        let title = escape(&self.title);
        let _ = write!(
            html,
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>{STYLE}</style>\n<noscript><style>{WITHOUT_SCRIPT}</style></noscript>\n{script}\n</head>\n<body>\n<main>\n\
             <header><h1>{title}</h1>\n"
        );
        if !self.subtitle.is_empty() {
            let _ = writeln!(html, "<p class=\"subtitle\">{}</p>", escape(&self.subtitle));
        }
        html.push_str("</header>\n");
        html.push_str(&self.render_summary());
        html.push_str(&self.render_contents());
        html.push_str(&self.body);
        if !self.footer.is_empty() {
            let _ = writeln!(html, "<footer>{}</footer>", escape(&self.footer));
        }
        html.push_str("</main>\n</body>\n</html>\n");
        html
    }

    fn heading(mut self, text: String, level: Level) -> Self {
        self.contents.push(Heading { text, level });
        let number = self.contents.len();
        let tag = level.tag();
        if let Some(heading) = self.contents.last() {
            let _ = writeln!(self.body, "<{tag} id=\"part-{number}\">{}</{tag}>", escape(&heading.text));
        }
        self
    }

    fn render_summary(&self) -> String {
        if self.summary.is_empty() {
            return String::new();
        }
        let mut html = "<dl class=\"summary\">\n".to_owned();
        for SummaryRow { label, value, status } in &self.summary {
            let value = status.map_or_else(|| escape(value), |status| status.badge(value));
            let _ = writeln!(html, "<dt>{}</dt><dd>{value}</dd>", escape(label));
        }
        html.push_str("</dl>\n");
        html
    }

    fn render_contents(&self) -> String {
        if self.contents.len() < 2 {
            return String::new();
        }
        let mut html = "<nav aria-label=\"Contents\"><b>Contents</b>\n<ul>\n".to_owned();
        for (idx, heading) in self.contents.iter().enumerate() {
            let class = if heading.level == Level::Subsection { " class=\"sub\"" } else { "" };
            let _ =
                writeln!(html, "<li{class}><a href=\"#part-{}\">{}</a></li>", idx + 1, escape(&heading.text));
        }
        html.push_str("</ul></nav>\n");
        html
    }
}

impl Level {
    fn tag(self) -> &'static str {
        match self {
            Self::Section => "h2",
            Self::Subsection => "h3",
        }
    }
}

const WITHOUT_SCRIPT: &str = ".interactive{display:none}.static{display:block}";

const STYLE: &str = "
:root{color-scheme:light}
body{margin:0;background:#f4f5f7;color:#1a1a1a;font:16px/1.55 Helvetica,Arial,'Liberation Sans',sans-serif}
main{box-sizing:border-box;max-width:1000px;margin:0 auto;padding:2rem 2.5rem 3rem;background:#fff;min-height:100vh}
h1{font-size:1.75rem;line-height:1.25;margin:0 0 .3rem}
h2{font-size:1.35rem;margin:2.6rem 0 .8rem;padding-bottom:.25rem;border-bottom:2px solid #0072b2}
h3{font-size:1.08rem;margin:1.8rem 0 .5rem}
.subtitle{color:#555;margin:.2rem 0 1.2rem}
a{color:#00598c}
p,ul{max-width:52rem}
.summary{display:grid;grid-template-columns:max-content 1fr;gap:.3rem 1.4rem;margin:1.4rem 0;padding:1rem 1.3rem;
border:1px solid #b9cfdd;border-left:5px solid #0072b2;background:#f3f8fb;border-radius:4px}
.summary dt{font-weight:600}.summary dd{margin:0;font-variant-numeric:tabular-nums}
nav{margin:1.4rem 0;font-size:.95rem}nav ul{columns:2;margin:.4rem 0;padding-left:1.2rem}nav .sub{margin-left:1.2rem;list-style:circle}
.table{overflow-x:auto;margin:1.3rem 0}
table{border-collapse:collapse;font-size:.92rem;line-height:1.4}
caption{text-align:left;padding:.2rem 0 .5rem;color:#333}
th,td{padding:.32rem .8rem;border-bottom:1px solid #dcdfe3;text-align:left;vertical-align:top}
thead th{border-bottom:2px solid #8a949e;vertical-align:bottom}
tbody tr:nth-child(even){background:#f8f9fa}
th.n,td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.pass{color:#00654a;font-weight:600}.fail{color:#b03a00;font-weight:600}.note{color:#555}
figure{margin:1.6rem 0;padding:.6rem .6rem .8rem;border:1px solid #dcdfe3;border-radius:4px;background:#fff}
figcaption{font-size:.92rem;color:#333;padding:.3rem .6rem 0}
.plot{width:100%}.static{display:none}.static svg{max-width:100%;height:auto}
aside{margin:1rem 0;padding:.6rem 1rem;border-left:4px solid #e69f00;background:#fdf7ea;font-size:.95rem;max-width:50rem}
pre{overflow-x:auto;background:#f4f5f7;border:1px solid #dcdfe3;border-radius:4px;padding:.7rem 1rem;font-size:.86rem;line-height:1.4}
footer{margin-top:3rem;padding-top:.8rem;border-top:1px solid #dcdfe3;color:#555;font-size:.85rem;overflow-wrap:anywhere}
@media (max-width:700px){main{padding:1rem}nav ul{columns:1}.summary{grid-template-columns:1fr;gap:0}.summary dd{margin-bottom:.5rem}}
@media print{body{background:#fff;font-size:10.5pt}main{max-width:none;padding:0}nav{display:none}
.interactive{display:none}.static{display:block}figure,table,aside,.summary{break-inside:avoid}h2,h3{break-after:avoid}a{color:inherit;text-decoration:none}}
";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::demo;

    #[test]
    fn edge_all_text_is_escaped() {
        let bad = "<img src=x onerror=alert(1)>&";
        let page = ReportPage::new(bad)
            .subtitle(bad)
            .summary(bad, bad, Some(Status::Fail))
            .section(bad)
            .subsection(bad)
            .paragraph(bad)
            .note(bad)
            .list([bad])
            .preformatted(bad)
            .table(Table::new(bad, [bad, bad]).row([Cell::text(bad), Cell::check(Status::Pass, bad)]))
            .footer(bad)
            .render();
        assert!(!page.contains("<img"));
        // Title 2, subtitle 1, summary 2, headings with their contents entries 4, four blocks, table 5,
        // footer 1.
        assert_eq!(page.matches("&lt;img").count(), 19);
    }

    #[test]
    fn law_the_page_refers_to_nothing_outside_itself() {
        let page = demo::page().render();
        let without_script =
            page.replace(&plotly::head_script(), "").replace("http://www.w3.org/2000/svg", "");
        for reference in ["http:", "https:", "src=", "@import", "url(h"] {
            assert!(!without_script.contains(reference), "{reference}");
        }
        assert!(without_script.len() < 2_000_000, "{}", without_script.len());
    }

    #[test]
    fn law_numeric_columns_are_aligned_right_with_their_heading() {
        let table = Table::new("t", ["name", "value"])
            .row([Cell::text("a"), Cell::number(1.0, 3)])
            .row([Cell::text("b"), Cell::Empty]);
        let html = table.render(1);
        assert!(
            html.contains("<th scope=\"col\" class=\"n\">value</th>")
                && html.contains("<th scope=\"col\">name</th>")
        );
    }

    #[test]
    fn edge_a_row_of_the_wrong_width_is_refused() {
        assert!(std::panic::catch_unwind(|| Table::new("t", ["a", "b"]).row([Cell::Empty])).is_err());
    }
}
