//! Feature files: found and read, outlines expanded, and every step resolved before any scenario
//! runs.

use super::step_registry::StepRegistry;
use cucumber::feature::Ext;
use cucumber::gherkin::tagexpr::TagOperation;
use cucumber::gherkin::{Feature, GherkinEnv, ParseFileError, Scenario, Step};
use cucumber::tag::Ext as _;
use std::fmt;
use std::path::{Path, PathBuf};

/// Checked feature files.
#[derive(Debug)]
pub struct Features(pub(super) Vec<Feature>);

/// Filter for scenarios.
#[derive(Debug, Default)]
pub struct ScenarioFilter {
    /// Tag expression, such as `@slow and not @nurse`.
    pub tags: Option<TagOperation>,
    /// Text that the scenario name must contain.
    pub name: Option<String>,
}

impl ScenarioFilter {
    /// Parses a tag expression.
    ///
    /// # Errors
    /// The text is no tag expression.
    pub fn tags(text: &str) -> Result<TagOperation, TagExpressionError> {
        text.parse().map_err(|_| TagExpressionError(text.to_owned()))
    }

    fn admits(&self, feature: &Feature, tags: &[String], scenario: &Scenario) -> bool {
        let all = || feature.tags.iter().chain(tags).chain(&scenario.tags);
        let named = self.name.as_ref().is_none_or(|name| scenario.name.contains(name.as_str()));
        named && self.tags.as_ref().is_none_or(|wanted| wanted.eval(all()))
    }
}

/// Rejected tag expression.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no expression over tags, as \"@nurse and not @slow\"")]
pub struct TagExpressionError(pub String);

/// Problems in feature files, each with file and line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeatureErrors(pub Vec<String>);

impl fmt::Display for FeatureErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join("\n"))
    }
}

impl Features {
    /// Reads files, and all files that end with `.feature` in folders and their subfolders.
    ///
    /// # Errors
    /// [`FeatureErrors`] with all problems: unreadable files, files that are no features, unknown
    /// steps, and an empty result.
    pub fn read(paths: &[PathBuf], filter: &ScenarioFilter) -> Result<Features, FeatureErrors> {
        let (mut files, mut bad, mut features) = (vec![], vec![], vec![]);
        for path in paths {
            if let Err(problem) = find(path, true, &mut files) {
                bad.push(format!("{}: {problem}", path.display()));
            }
        }
        for file in &files {
            match read(file) {
                Ok(feature) => {
                    bad.extend(check(file, &feature));
                    features.push(feature);
                }
                Err(errors) => bad.extend(errors.0),
            }
        }
        if bad.is_empty() && features.is_empty() {
            let paths: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
            bad.push(format!("{}: there is no file ending with .feature", paths.join(", ")));
        }
        if !bad.is_empty() {
            return Err(FeatureErrors(bad));
        }
        for feature in &mut features {
            let whole = feature.clone();
            feature.scenarios.retain(|scenario| filter.admits(&whole, &[], scenario));
            for rule in &mut feature.rules {
                let tags = rule.tags.clone();
                rule.scenarios.retain(|scenario| filter.admits(&whole, &tags, scenario));
            }
        }
        features.retain(|feature| feature.count_scenarios() > 0);
        if features.is_empty() {
            return Err(FeatureErrors(vec!["no scenario has such a name and such tags".to_owned()]));
        }
        Ok(Features(features))
    }

    /// Returns the number of scenarios. Each row of an outline counts.
    pub fn scenarios(&self) -> usize {
        self.0.iter().map(Ext::count_scenarios).sum()
    }
}

fn find(path: &Path, named: bool, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    if path.is_dir() {
        let mut inside =
            std::fs::read_dir(path)?.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
        inside.sort();
        return inside.iter().try_for_each(|path| find(path, false, files));
    }
    if named {
        std::fs::metadata(path)?;
    }
    if (named || path.extension().is_some_and(|extension| extension == "feature"))
        && !files.iter().any(|file| file == path)
    {
        files.push(path.to_owned());
    }
    Ok(())
}

fn read(file: &Path) -> Result<Feature, FeatureErrors> {
    let single = |problem: String| FeatureErrors(vec![problem]);
    let shown = file.display();
    let feature = Feature::parse_path(file, GherkinEnv::default()).map_err(|problem| match problem {
        ParseFileError::Reading { source, .. } => single(format!("{shown}: {source}")),
        ParseFileError::Parsing { error, source, .. } => {
            let error = error.map(|error| format!(" ({error})")).unwrap_or_default();
            single(format!("{shown}: no feature in Gherkin{error}: {source}"))
        }
    })?;
    feature.expand_examples().map_err(|problem| single(format!("{shown}: {problem}")))
}

/// Returns the unknown steps. The rows of an outline share a line, so each line is reported once.
fn check(file: &Path, feature: &Feature) -> Vec<String> {
    let backgrounds = feature.background.iter().chain(feature.rules.iter().filter_map(|rule| rule.background.as_ref()));
    let scenarios = feature.scenarios.iter().chain(feature.rules.iter().flat_map(|rule| &rule.scenarios));
    let steps =
        backgrounds.flat_map(|background| &background.steps).chain(scenarios.flat_map(|scenario| &scenario.steps));
    let mut bad: Vec<(usize, String)> = vec![];
    for step in steps {
        let line = step.position.line;
        if let Err(problem) = StepRegistry::get().read(step)
            && bad.iter().all(|(known, _)| *known != line)
        {
            bad.push((line, format!("{}:{line}: {}: {problem}", file.display(), step_text(step))));
        }
    }
    bad.into_iter().map(|(_, problem)| problem).collect()
}

/// Formats a step as in its file.
pub(super) fn step_text(step: &Step) -> String {
    format!("{} {}", step.keyword.trim(), step.value)
}
