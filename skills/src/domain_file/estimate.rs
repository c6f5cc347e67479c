//! Estimates in CEL.

use super::form::{EstimateForm, ParameterForm, ParameterKind, TaskForm};
use crate::descriptor::{Estimate, EstimateContext, EstimateError, SkillDescriptor};
use crate::environment::{Environment, EnvironmentDescriptor, Routes};
use cel::{Context, Program};
use consort_protocol::expression;
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::knowledge::Attributes;
use consort_protocol::mission::{DomainReference, TaskSpec};
use consort_protocol::units::Seconds;
use std::collections::{BTreeMap, HashMap};

/// The estimate of a task type of a domain file.
pub(super) struct DeclaredEstimate {
    task_type: TaskType,
    parameters: BTreeMap<String, ParameterForm>,
    time_s: Expression,
    energy: Option<Expression>,
    ends_at: Option<String>,
    requires: Option<Expression>,
    domain: Option<DomainReference>,
}

/// Variable with the attributes of the robot.
const ATTRIBUTES: &str = "attributes";

/// Variables of the robot.
struct RobotVariables<'a> {
    speed: f64,
    discharge: f64,
    attributes: &'a Attributes,
}

struct Expression {
    text: String,
    program: Program,
}

impl Expression {
    fn compile(text: &str) -> Result<Expression, String> {
        Ok(Expression { text: text.to_owned(), program: expression::compile(text)? })
    }

    /// Checks whether the expression uses attributes of the robot, which are not known beforehand.
    fn uses_attributes(&self) -> bool {
        expression::fields_used(self.program.expression()).iter().any(|(name, _)| name == ATTRIBUTES)
    }

    /// Evaluates the expression to `true` or `false`.
    fn condition(&self, variables: &Context<'static, 'static>) -> Result<bool, String> {
        match self.program.execute(variables) {
            Ok(cel::Value::Bool(holds)) => Ok(holds),
            Ok(other) => Err(format!("is {other:?}; allowed is true or false")),
            Err(problem) => Err(format!("has no value: {problem}")),
        }
    }

    /// Evaluates the expression to a finite number of 0 or more.
    fn number(&self, variables: &Context<'static, 'static>) -> Result<f64, String> {
        let number = match self.program.execute(variables) {
            Ok(cel::Value::Float(number)) => number,
            Ok(cel::Value::Int(number)) => number as f64,
            Ok(cel::Value::UInt(number)) => number as f64,
            Ok(other) => return Err(format!("`{}` is {other:?}; allowed is a number", self.text)),
            Err(problem) => {
                return Err(format!("`{}`: {problem}; numbers are written with a decimal point, as in 2.0", self.text));
            }
        };
        match number.is_finite() && number >= 0.0 {
            true => Ok(number),
            false => Err(format!("`{}` is {number}; allowed are finite numbers of 0 or more", self.text)),
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
        let time_s = Expression::compile(&form.time_s).map_err(at("time_s"))?;
        let energy = form.energy.as_deref().map(Expression::compile).transpose().map_err(at("energy"))?;
        if let Some(name) = &form.ends_at
            && task.parameters.get(name).is_none_or(|parameter| parameter.kind != ParameterKind::Place)
        {
            return Err(("ends_at", format!("{name} is no parameter of type place")));
        }
        let (parameters, ends_at) = (task.parameters.clone(), form.ends_at.clone());
        let (task_type, requires, domain) = (task_type.clone(), None, None);
        let estimate = DeclaredEstimate { task_type, parameters, time_s, energy, ends_at, requires, domain };
        let variables = estimate.example();
        for (key, number) in [("time_s", Some(&estimate.time_s)), ("energy", estimate.energy.as_ref())] {
            // The attributes of robots differ.
            if let Some(number) = number.filter(|number| !number.uses_attributes()) {
                number.number(&variables).map_err(at(key))?;
            }
        }
        Ok(estimate)
    }

    /// Adds the condition of the task type on its robot.
    pub(super) fn requiring(self, condition: &str) -> Result<DeclaredEstimate, String> {
        let requires = Expression::compile(condition)?;
        if !requires.uses_attributes() {
            requires.condition(&self.example()).map_err(|problem| format!("`{condition}` {problem}"))?;
        }
        Ok(DeclaredEstimate { requires: Some(requires), ..self })
    }

    /// Returns the estimate for tasks of this domain only.
    pub(super) fn of_domain(self, domain: DomainReference) -> DeclaredEstimate {
        DeclaredEstimate { domain: Some(domain), ..self }
    }

    /// Returns variables with a value of each type.
    fn example(&self) -> Context<'static, 'static> {
        let example = |parameter: &ParameterForm| match parameter.kind {
            ParameterKind::Seconds | ParameterKind::Number | ParameterKind::Integer => {
                parameter.minimum.or(parameter.maximum).unwrap_or(1.0).to_string()
            }
            ParameterKind::Bool => "true".to_owned(),
            ParameterKind::Place | ParameterKind::Role | ParameterKind::Text => {
                parameter.one_of.first().cloned().unwrap_or_else(|| "example".to_owned())
            }
        };
        let texts = self.parameters.iter().map(|(name, parameter)| (name.clone(), example(parameter))).collect();
        let robot = RobotVariables { speed: 1.0, discharge: 0.001, attributes: &Attributes::default() };
        self.variables(&texts, &robot, |_| Ok::<f64, EstimateError>(1.0)).expect("examples are valid")
    }

    fn variables<E>(
        &self,
        texts: &BTreeMap<String, String>,
        robot: &RobotVariables<'_>,
        distance: impl Fn(&str) -> Result<f64, E>,
    ) -> Result<Context<'static, 'static>, E> {
        let mut context = expression::variables();
        let mut distances = HashMap::new();
        for (name, parameter) in &self.parameters {
            let Some(text) = texts.get(name) else { continue };
            let value = match parameter.kind {
                ParameterKind::Seconds | ParameterKind::Number | ParameterKind::Integer => {
                    cel::Value::Float(text.parse().unwrap_or(f64::NAN))
                }
                ParameterKind::Bool => cel::Value::Bool(text == "true"),
                ParameterKind::Place => {
                    distances.insert(name.clone(), cel::Value::Float(distance(text)?));
                    cel::Value::from(text.clone())
                }
                ParameterKind::Role | ParameterKind::Text => cel::Value::from(text.clone()),
            };
            context.add_variable_from_value(name.clone(), value);
        }
        context.add_variable_from_value("distance", cel::Value::from(distances));
        context.add_variable_from_value("speed", cel::Value::Float(robot.speed));
        context.add_variable_from_value("discharge", cel::Value::Float(robot.discharge));
        let attributes = robot.attributes.iter().map(|(name, value)| (name.clone(), expression::cel_value(value)));
        context.add_variable_from_value(ATTRIBUTES, attributes.collect::<HashMap<String, cel::Value>>());
        Ok(context)
    }
}

impl SkillDescriptor for DeclaredEstimate {
    fn task_type(&self) -> &TaskType {
        &self.task_type
    }

    fn required_descriptors(&self) -> Vec<&'static str> {
        let travels = self.parameters.values().any(|parameter| parameter.kind == ParameterKind::Place);
        if travels { vec![Routes::KIND] } else { vec![] }
    }

    fn estimate(
        &self,
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError> {
        task.check_domain(self.domain.as_ref())?;
        let place = |text: &str| {
            text.parse::<PlaceId>().map_err(|problem| EstimateError::Expression {
                task_type: self.task_type.clone(),
                problem: problem.to_string(),
            })
        };
        let distance = |text: &str| {
            let (to, routes) = (place(text)?, environment.get::<Routes>()?.without_closed(&context.closed));
            Ok::<f64, EstimateError>(match context.pose {
                Some(pose) => routes.distance_left(&context.place, pose, &to)?.get(),
                None => routes.distance(&context.place, &to)?.get(),
            })
        };
        let (speed, discharge, attributes) = (context.speed.get(), context.discharge.get(), &context.attributes);
        let variables = self.variables(&task.parameters, &RobotVariables { speed, discharge, attributes }, distance)?;
        if let Some(requires) = &self.requires {
            let lacks = |problem| EstimateError::Requirement {
                task_type: self.task_type.clone(),
                condition: requires.text.clone(),
                problem,
            };
            let holds = requires.condition(&variables).map_err(lacks)?;
            holds.then_some(()).ok_or_else(|| lacks("is false".to_owned()))?;
        }
        let failed = |problem| EstimateError::Expression { task_type: self.task_type.clone(), problem };
        let time_s = self.time_s.number(&variables).map_err(failed)?;
        let time = Seconds::new(time_s).map_err(|problem| failed(problem.to_string()))?;
        let ends_at = match self.ends_at.as_ref().and_then(|name| task.parameters.get(name)) {
            Some(text) => place(text)?,
            None => context.place.clone(),
        };
        let mut estimate = Estimate::of_duration(time, context, ends_at);
        if let Some(energy) = &self.energy {
            estimate.energy = energy.number(&variables).map_err(failed)?;
        }
        Ok(estimate)
    }
}
