//! Files of instances: Solomon's text format, and CSV.

use super::instance::{Instance, Site};
use std::path::Path;

/// Columns of a CSV file, in their order.
const COLUMNS: [&str; 7] = ["customer", "x", "y", "demand", "ready", "due", "service"];

/// A file is no instance.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct InstanceError {
    /// Line, counted from 1.
    pub line: usize,
    /// The problem, and what is allowed.
    pub problem: String,
}

fn error(line: usize, problem: impl Into<String>) -> InstanceError {
    InstanceError { line, problem: problem.into() }
}

/// Reads an instance. `robots` and `capacity` replace the values of the file; a CSV file has none, so it needs a number
/// of robots, and without a capacity it is unlimited. The name is that of the file.
///
/// # Errors
/// [`InstanceError`] with the line.
pub fn read_instance(
    text: &str,
    path: &Path,
    robots: Option<usize>,
    capacity: Option<f64>,
) -> Result<Instance, InstanceError> {
    let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let lines: Vec<(usize, &str)> =
        (1..).zip(text.trim_start_matches('\u{feff}').lines()).filter(|(_, line)| !line.trim().is_empty()).collect();
    let &(first, head) = lines.first().ok_or_else(|| error(1, "the file is empty"))?;
    if head.contains(',') {
        let columns: Vec<String> = head.split(',').map(|column| column.trim().to_lowercase()).collect();
        if columns != COLUMNS {
            return Err(error(first, format!("the columns are {}; allowed: {}", columns.join(","), COLUMNS.join(","))));
        }
        let needed = || error(first, "a CSV file has no number of robots; give it with --robots");
        let sites = read_sites(&lines[1..], |line| line.split(',').map(str::trim).collect())?;
        let (depot, jobs) = split_depot(sites, first)?;
        let robots = robots.ok_or_else(needed)?;
        return Ok(Instance::new(name, depot, jobs, robots, capacity.unwrap_or(f64::INFINITY)));
    }
    let words = |line: &str| line.split_whitespace().map(str::to_lowercase).collect::<Vec<_>>();
    let begins = |line: &str, word: &str| words(line).first().is_some_and(|first| first == word);
    let section = |word: &str| {
        lines.iter().position(|(_, line)| begins(line, word)).ok_or_else(|| {
            let what = format!("there is no section {}; allowed: Solomon's text format, or CSV", word.to_uppercase());
            error(lines.last().map_or(1, |(line, _)| *line), what)
        })
    };
    let (vehicle, customer) = (section("vehicle")?, section("customer")?);
    let fleet = lines[vehicle..customer.max(vehicle)]
        .iter()
        .find(|(_, line)| line.trim_start().starts_with(|first: char| first.is_ascii_digit()));
    let &(line, fleet) =
        fleet.ok_or_else(|| error(lines[vehicle].0, "VEHICLE needs a line with number and capacity"))?;
    let fleet_words: Vec<&str> = fleet.split_whitespace().collect();
    let [number, limit] = fleet_words[..] else {
        return Err(error(line, format!("{:?} is not a number of vehicles and a capacity", fleet.trim())));
    };
    let number = number.parse().map_err(|_| error(line, format!("{number:?} is not a number of vehicles")))?;
    let limit = positive(limit, line, "capacity")?;
    let rows: Vec<(usize, &str)> = lines[customer + 1..]
        .iter()
        .copied()
        .filter(|(_, line)| !line.trim_start().to_lowercase().starts_with("cust"))
        .collect();
    let (depot, jobs) = split_depot(read_sites(&rows, |line| line.split_whitespace().collect())?, lines[customer].0)?;
    Ok(Instance::new(name, depot, jobs, robots.unwrap_or(number), capacity.unwrap_or(limit)))
}

fn positive(text: &str, line: usize, column: &str) -> Result<f64, InstanceError> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite() && *number >= 0.0);
    number.ok_or_else(|| error(line, format!("{column}: {text:?} is not a number, 0 or more")))
}

fn read_sites<'t>(
    lines: &[(usize, &'t str)],
    split: impl Fn(&'t str) -> Vec<&'t str>,
) -> Result<Vec<Site>, InstanceError> {
    let site = |(number, (line, text)): (usize, &(usize, &'t str))| {
        let values = split(text);
        let [customer, x, y, demand, ready, due, service] = values[..] else {
            let what = format!("{} values; needed are {}: {}", values.len(), COLUMNS.len(), COLUMNS.join(", "));
            return Err(error(*line, what));
        };
        if customer.parse() != Ok(number) {
            return Err(error(*line, format!("customer: is {customer:?}, must be {number}: 0 is the depot")));
        }
        let position = |text: &str, column| {
            let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
            number.ok_or_else(|| error(*line, format!("{column}: {text:?} is not a number")))
        };
        let of = |text, column| positive(text, *line, column);
        let (ready, due) = (of(ready, "ready")?, of(due, "due")?);
        if due < ready {
            return Err(error(*line, format!("due: is {due}, before ready, {ready}")));
        }
        let (x, y) = (position(x, "x")?, position(y, "y")?);
        Ok(Site { x, y, demand: of(demand, "demand")?, ready, due, service: of(service, "service")? })
    };
    lines.iter().enumerate().map(site).collect()
}

fn split_depot(mut sites: Vec<Site>, line: usize) -> Result<(Site, Vec<Site>), InstanceError> {
    if sites.is_empty() {
        return Err(error(line, "there is no depot: customer 0"));
    }
    let depot = sites.remove(0);
    Ok((depot, sites))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CSV: &str = "customer,x,y,demand,ready,due,service\n0,40,50,0,0,1236,0\n1,45,68,10,912,967,90\n";
    const TEXT: &str = "C101\n\nVEHICLE\nNUMBER     CAPACITY\n  25         200\n\nCUSTOMER\nCUST NO.  XCOORD.   YCOORD.    DEMAND   READY TIME  \
                        DUE DATE   SERVICE   TIME\n\n    0      40         50          0          0       1236          0   \n    1      45         \
                        68         10        912        967         90   \n";

    fn read(text: &str, file: &str) -> Result<Instance, String> {
        read_instance(text, Path::new(file), None, None).map_err(|error| error.to_string())
    }

    #[test]
    fn both_formats_give_the_same_instance() {
        let csv = read_instance(CSV, Path::new("a/C101.25.csv"), Some(25), Some(200.0)).unwrap();
        assert_eq!(csv.name, "C101.25");
        assert_eq!(read(TEXT, "C101.25.txt").unwrap(), csv);
        // 18.68…
        assert_eq!(csv.distance(0, csv.depot_place()), 18.6);
        let replaced = read_instance(TEXT, Path::new("C101.txt"), Some(3), Some(50.0)).unwrap();
        assert_eq!((replaced.robots, replaced.capacity), (3, 50.0));
    }

    #[test]
    fn wrong_files_are_reported_with_the_line() {
        for (text, expected) in [
            ("", "line 1: the file is empty"),
            (CSV, "line 1: a CSV file has no number of robots; give it with --robots"),
            ("a,b\n", "line 1: the columns are a,b; allowed: customer,x,y,demand,ready,due,service"),
            (&CSV.replace("\n1,", "\n2,"), "line 3: customer: is \"2\", must be 1: 0 is the depot"),
            (&CSV.replace("967", "x"), "line 3: due: \"x\" is not a number, 0 or more"),
            (&CSV.replace("967", "9"), "line 3: due: is 9, before ready, 912"),
            (&CSV.replace(",90", ""), "line 3: 6 values; needed are 7: customer, x, y, demand, ready, due, service"),
            ("C101\n", "line 1: there is no section VEHICLE; allowed: Solomon's text format, or CSV"),
            (&TEXT.replace("  25  ", "  many  "), "line 3: VEHICLE needs a line with number and capacity"),
            (
                &TEXT.replace("  25 ", "  25 3 "),
                "line 5: \"25 3         200\" is not a number of vehicles and a capacity",
            ),
        ] {
            assert_eq!(read(text, "a").unwrap_err(), expected, "{text}");
        }
    }
}
