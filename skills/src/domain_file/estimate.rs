//! Estimates in CEL.

use super::expression::{ATTRIBUTES, DISTANCE, Expression, TRAVEL_S};
use super::form::{EstimateForm, ParameterForm, ParameterKind, TaskForm};
use super::requirement::{Requirement, Unmet};
use crate::descriptor::{Estimate, EstimateContext, EstimateError, SkillDescriptor};
use crate::environment::{Environment, EnvironmentDescriptor, Passages, Routes};
use crate::waypoints::parse_points;
use cel::Context;
use consort_protocol::expression;
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::knowledge::Attributes;
use consort_protocol::mission::{DomainReference, TaskSpec};
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, Seconds};
use std::collections::{BTreeMap, HashMap};

/// The estimate of a task type of a domain file.
pub(super) struct DeclaredEstimate {
    task_type: TaskType,
    parameters: BTreeMap<String, ParameterForm>,
    time_s: Formula,
    energy: Option<Formula>,
    /// Multiple of the robot's discharge rate, for a task without an expression for its energy.
    discharge: f64,
    ends_at: Option<String>,
    requires: Option<Requirement>,
    domain: Option<DomainReference>,
}

/// Variables of the robot.
struct RobotVariables<'a> {
    speed: f64,
    discharge: f64,
    attributes: &'a Attributes,
}

/// A number. The most frequent forms are computed without CEL, with the same result.
enum Formula {
    /// A number, such as `2.0`.
    Constant(f64),
    /// A parameter of the task, such as `seconds`.
    Parameter(String),
    /// The time of the drive to the place, or along the path, of a parameter, such as `travel_s.to`.
    TravelTime(String),
    /// Any other expression.
    Expression(Expression),
}

impl Formula {
    fn compile(text: &str, parameters: &BTreeMap<String, ParameterForm>) -> Result<Formula, String> {
        let kind = |name: &str| parameters.get(name).map(|parameter| parameter.kind);
        let is_number = |name: &str| {
            matches!(kind(name), Some(ParameterKind::Seconds | ParameterKind::Number | ParameterKind::Integer))
        };
        let is_drive = |name: &str| matches!(kind(name), Some(ParameterKind::Place | ParameterKind::Points));
        if let Some(number) = text.parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0) {
            return Ok(Formula::Constant(number));
        }
        let of_drive = text.strip_prefix(TRAVEL_S).and_then(|rest| rest.strip_prefix('.'));
        match of_drive {
            Some(name) if is_drive(name) => Ok(Formula::TravelTime(name.to_owned())),
            None if is_number(text) => Ok(Formula::Parameter(text.to_owned())),
            _ => Expression::compile(text).map(Formula::Expression),
        }
    }

    fn expression(&self) -> Option<&Expression> {
        match self {
            Formula::Expression(expression) => Some(expression),
            Formula::Constant(_) | Formula::Parameter(_) | Formula::TravelTime(_) => None,
        }
    }

    fn needs_routes(&self) -> bool {
        match self {
            Formula::TravelTime(_) => true,
            Formula::Constant(_) | Formula::Parameter(_) => false,
            Formula::Expression(expression) => expression.uses_drives,
        }
    }
}

impl DeclaredEstimate {
    /// Compiles the estimate of a task type, and evaluates it once with example values.
    pub(super) fn compile(
        task_type: &TaskType,
        task: &TaskForm,
        form: &EstimateForm,
    ) -> Result<DeclaredEstimate, (&'static str, String)> {
        let at = |key| move |problem| (key, problem);
        let formula = |text: &str| Formula::compile(text, &task.parameters);
        let time_s = formula(&form.time_s).map_err(at("time_s"))?;
        let energy = form.energy.as_deref().map(formula).transpose().map_err(at("energy"))?;
        if let Some(name) = &form.ends_at
            && task.parameters.get(name).is_none_or(|parameter| parameter.kind != ParameterKind::Place)
        {
            return Err(("ends_at", format!("{name} is no parameter of type place")));
        }
        let (parameters, ends_at) = (task.parameters.clone(), form.ends_at.clone());
        let (task_type, requires, domain, discharge) = (task_type.clone(), None, None, 1.0);
        let estimate = DeclaredEstimate { task_type, parameters, time_s, energy, discharge, ends_at, requires, domain };
        let variables = estimate.example();
        for (key, number) in [("time_s", Some(&estimate.time_s)), ("energy", estimate.energy.as_ref())] {
            // The attributes of robots differ.
            let expression = number.and_then(Formula::expression).filter(|number| !number.uses_attributes());
            if let Some(number) = expression {
                number.number(&variables).map_err(at(key))?;
            }
        }
        Ok(estimate)
    }

    /// Sets the multiple of the robot's discharge rate.
    pub(super) fn with_discharge(self, discharge: f64) -> DeclaredEstimate {
        DeclaredEstimate { discharge, ..self }
    }

    /// Adds the condition of the task type on its robot. `declared` are the readings of all domains.
    pub(super) fn requiring(
        self,
        condition: &str,
        declared: &BTreeMap<String, ParameterForm>,
    ) -> Result<DeclaredEstimate, String> {
        let requires = Requirement::compile(condition, declared, self.example())?;
        Ok(DeclaredEstimate { requires: Some(requires), ..self })
    }

    /// Returns the estimate for tasks of this domain only.
    pub(super) fn of_domain(self, domain: Option<DomainReference>) -> DeclaredEstimate {
        DeclaredEstimate { domain, ..self }
    }

    fn formulas(&self) -> impl Iterator<Item = &Formula> {
        std::iter::once(&self.time_s).chain(&self.energy)
    }

    fn expressions(&self) -> impl Iterator<Item = &Expression> {
        self.formulas().filter_map(Formula::expression).chain(self.requires.as_ref().map(Requirement::expression))
    }

    /// Returns variables with a value of each type.
    fn example(&self) -> Context<'static, 'static> {
        let example = |(name, parameter): (&String, &ParameterForm)| (name.clone(), parameter.example());
        let texts = self.parameters.iter().map(example).collect();
        let robot = RobotVariables { speed: 1.0, discharge: 0.001, attributes: &Attributes::default() };
        self.variables(&texts, &robot, |_, _| Ok::<_, EstimateError>(Drive::example())).expect("examples are valid")
    }

    fn variables<E>(
        &self,
        texts: &BTreeMap<String, String>,
        robot: &RobotVariables<'_>,
        drive: impl Fn(&str, ParameterKind) -> Result<Drive, E>,
    ) -> Result<Context<'static, 'static>, E> {
        let mut context = expression::variables();
        let (mut distances, mut times) = (HashMap::new(), HashMap::new());
        for (name, parameter) in &self.parameters {
            let Some(text) = texts.get(name) else { continue };
            let value = match parameter.kind {
                ParameterKind::Seconds | ParameterKind::Number | ParameterKind::Integer => {
                    cel::Value::Float(text.parse().unwrap_or(f64::NAN))
                }
                ParameterKind::Bool => cel::Value::Bool(text == "true"),
                ParameterKind::Place | ParameterKind::Points => {
                    let Drive { length, time } = drive(name, parameter.kind)?;
                    distances.insert(name.clone(), cel::Value::Float(length.get()));
                    times.insert(name.clone(), cel::Value::Float(time.get()));
                    cel::Value::from(text.clone())
                }
                _ => cel::Value::from(text.clone()),
            };
            context.add_variable_from_value(name.clone(), value);
        }
        context.add_variable_from_value(DISTANCE, cel::Value::from(distances));
        context.add_variable_from_value(TRAVEL_S, cel::Value::from(times));
        context.add_variable_from_value("speed", cel::Value::Float(robot.speed));
        context.add_variable_from_value("discharge", cel::Value::Float(robot.discharge));
        let attributes = robot.attributes.iter().map(|(name, value)| (name.clone(), expression::cel_value(value)));
        context.add_variable_from_value(ATTRIBUTES, attributes.collect::<HashMap<String, cel::Value>>());
        Ok(context)
    }

    fn failed(&self, problem: String) -> EstimateError {
        EstimateError::Expression { task_type: self.task_type.clone(), problem }
    }

    /// Parses a required parameter.
    fn parsed<T, E: ToString>(
        &self,
        task: &TaskSpec,
        name: &str,
        parse: impl FnOnce(&str) -> Result<T, E>,
    ) -> Result<T, EstimateError> {
        let (task_type, parameter) = (self.task_type.clone(), name.to_owned());
        let Some(text) = task.parameters.get(name) else {
            return Err(EstimateError::MissingParameter { task_type, parameter });
        };
        parse(text).map_err(|problem| EstimateError::Parameter {
            task_type,
            parameter,
            value: text.clone(),
            problem: problem.to_string(),
        })
    }

    /// Computes the drive to the place, or along the path, of a parameter.
    fn drive(
        &self,
        (name, kind): (&str, ParameterKind),
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
    ) -> Result<Drive, EstimateError> {
        let routes = environment.get::<Routes>()?;
        if kind == ParameterKind::Points {
            let points = self.parsed(task, name, |text| parse_points(text.split(';')))?;
            let length = length_along(context.pose.or(routes.pose(&context.place)), &points);
            return Ok(Drive { length, time: length.at(context.speed) });
        }
        let to = self.parsed(task, name, str::parse::<PlaceId>)?;
        let open = routes.without_closed(&context.closed);
        let known = environment.find::<Passages>();
        let routes = open.limited(&context.limits, context.speed, known);
        let length = match context.pose {
            Some(pose) => routes.distance_left(&context.place, pose, &to)?,
            None => routes.distance(&context.place, &to)?,
        };
        let limited = (!context.limits.is_empty())
            .then(|| known.cloned().unwrap_or_default().with_limits(context.limits.clone()));
        // Most maps have no doors, lifts or limits.
        let time = match limited.as_ref().or(known).filter(|passages| !passages.is_empty()) {
            None => length.at(context.speed),
            Some(passages) => {
                let pose = context.pose.or(routes.pose(&context.place)).unwrap_or_default();
                routes.time_left(&context.place, pose, &to, context.speed, passages)?
            }
        };
        Ok(Drive { length, time })
    }

    /// Evaluates a formula to a finite number of 0 or more.
    fn number(
        &self,
        formula: &Formula,
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
        variables: Option<&Context<'static, 'static>>,
    ) -> Result<f64, EstimateError> {
        match formula {
            Formula::Constant(number) => Ok(*number),
            Formula::Parameter(name) => self.parsed(task, name, |text| match text.parse::<f64>() {
                Ok(number) if number.is_finite() && number >= 0.0 => Ok(number),
                Ok(_) | Err(_) => Err("allowed are finite numbers of 0 or more"),
            }),
            Formula::TravelTime(name) => {
                let kind = self.parameters.get(name).map_or(ParameterKind::Place, |parameter| parameter.kind);
                Ok(self.drive((name, kind), task, context, environment)?.time.get())
            }
            Formula::Expression(expression) => {
                let variables = variables.expect("an estimate with an expression has variables");
                expression.number(variables).map_err(|problem| self.failed(problem))
            }
        }
    }
}

/// A drive from the robot's position.
struct Drive {
    length: Metres,
    time: Seconds,
}

impl Drive {
    fn example() -> Drive {
        Drive { length: Metres::new(1.0).expect("a length"), time: Seconds::new(1.0).expect("a duration") }
    }
}

/// Returns the length of a path in straight lines.
fn length_along(start: Option<Pose>, points: &[(f64, f64)]) -> Metres {
    let poses: Vec<Pose> = start.into_iter().chain(points.iter().map(|(x, y)| Pose::new(*x, *y, 0.0))).collect();
    poses.windows(2).fold(Metres::ZERO, |length, leg| length + leg[0].distance(leg[1]))
}

impl SkillDescriptor for DeclaredEstimate {
    fn task_type(&self) -> &TaskType {
        &self.task_type
    }

    fn required_descriptors(&self) -> Vec<&'static str> {
        let uses_routes = self.requires.iter().any(|requires| requires.expression().uses_drives);
        if uses_routes || self.formulas().any(Formula::needs_routes) { vec![Routes::KIND] } else { vec![] }
    }

    fn is_given(&self) -> bool {
        matches!(self.time_s, Formula::Parameter(_))
    }

    /// The time is that of a drive to a place, and the task ends there.
    fn destination(&self) -> Option<&str> {
        match (&self.time_s, &self.ends_at) {
            (Formula::TravelTime(to), Some(end)) if to == end => Some(to),
            _ => None,
        }
    }

    fn discharge_multiple(&self) -> Option<f64> {
        self.energy.is_none().then_some(self.discharge)
    }

    fn grows_with_drives(&self) -> bool {
        let grows = |formula: &Formula| formula.expression().is_none_or(Expression::grows_with_drives);
        self.formulas().all(grows) && self.requires.iter().all(|requires| !requires.expression().uses_drives)
    }

    fn estimate(
        &self,
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError> {
        task.check_domain(self.domain.as_ref())?;
        let uses_drives = self.expressions().any(|each| each.uses_drives);
        let drive = |name: &str, kind| match uses_drives {
            true => self.drive((name, kind), task, context, environment),
            false => Ok(Drive::example()),
        };
        let (speed, discharge, attributes) = (context.speed.get(), context.discharge.get(), &context.attributes);
        let robot = RobotVariables { speed, discharge, attributes };
        let needs_variables = self.expressions().next().is_some();
        let mut variables = needs_variables.then(|| self.variables(&task.parameters, &robot, drive)).transpose()?;
        if let (Some(requires), Some(variables)) = (&self.requires, &mut variables) {
            requires.check(variables, context.readings.as_ref()).map_err(|Unmet { problem, may_change }| {
                let (task_type, condition) = (self.task_type.clone(), requires.expression().text.clone());
                EstimateError::Requirement { task_type, condition, problem, may_change }
            })?;
        }
        let number = |formula| self.number(formula, task, context, environment, variables.as_ref());
        let time = Seconds::new(number(&self.time_s)?).map_err(|problem| self.failed(problem.to_string()))?;
        let ends_at = match &self.ends_at {
            Some(name) if task.parameters.contains_key(name) => self.parsed(task, name, str::parse::<PlaceId>)?,
            _ => context.place.clone(),
        };
        let mut estimate = Estimate::of_duration(time, context, ends_at);
        estimate.energy = match &self.energy {
            Some(energy) => number(energy)?,
            None => estimate.energy * self.discharge,
        };
        Ok(estimate)
    }
}
