//! `imrs demo`: runs cells of `examples/`, injects a fault at the worst moment, and explains the outcome.
//!
//! A demo is a [`Scene`] in [`SCENES`], and a function that explains a finished run ([`Story`]).

mod beam_lift;
mod belt_administrator;
mod conveyor;
mod failover_weld;
mod shared_tool;

use crate::args::DemoArgs;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::Output;
use crate::run::{DemoPlan, Moment, Planned, chosen, launch, plan};
use clap::ValueEnum;
use clap::builder::PossibleValue;
use imrs_launch::cells::{self, Loaded, Source};
use imrs_launch::{Outcome, Run, Story};
use imrs_runtime::script::Ramp;
use std::time::Duration;

/// A demo: a cell, a fault, and an explanation.
#[derive(Clone, Copy, Debug)]
pub struct Scene {
    /// The demo's name on the command line.
    name: &'static str,
    /// What the demo shows, in one line.
    about: &'static str,
    /// The name of the cell file.
    file: &'static str,
    /// The text of the cell.
    text: &'static str,
    /// The text that is printed before the run.
    introduction: &'static str,
    /// How long the demo runs.
    length: Duration,
    /// The demo's fault; `None` if the cell itself causes the trouble.
    moment: Option<Moment>,
    /// Simulated actions whose result changes with time. For each: the action, the action that starts the change, and
    /// how long the change takes.
    ramps: &'static [(&'static str, &'static str, Duration)],
    /// Explains what happened, and says whether the promise was kept.
    explain: fn(&Story<'_>) -> Outcome,
}

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// All demos.
static SCENES: &[Scene] = &[
    Scene {
        name: "beam-lift",
        about: "two arms lift a beam with a hoist: tightly coupled; a link fails in mid lift",
        file: "beam_lift.cell",
        text: include_str!("../../examples/beam_lift.cell"),
        introduction: "\
Two arms and a hoist meet at `lift` before every lift. While the arms move, the left one asks the right
one every few milliseconds whether it moves too (`beat`); an arm that gets no answer, or hears no
question, stops by itself.",
        length: Duration::from_secs(8),
        moment: Some(Moment {
            task: "armL",
            action: "start_lift",
            time: 2,
            after: ms(100),
            fault: Planned::Cut(["nl", "nr"], ms(40)),
            words: "in the middle of the second lift nothing passes between the arms for 40 ms",
        }),
        ramps: &[("read_height", "start_lift", ms(400))],
        explain: beam_lift::explain,
    },
    Scene {
        name: "failover-weld",
        about: "two robots weld, one stands by for the other: work-coupled; the first one's node dies",
        file: "weld_cell.cell",
        text: include_str!("../../examples/weld_cell.cell"),
        introduction: "\
Robot r1 welds spot after spot; r2 stands by. r1 may act only while it holds the lease, which r2 renews
by asking `alive` every few milliseconds. Both reach each other, and the tip dresser, through node nt.",
        length: Duration::from_secs(12),
        moment: Some(Moment {
            task: "r1",
            action: "weld",
            time: 1,
            after: ms(300),
            fault: Planned::Kill("n1"),
            words: "in the middle of the first weld the node of r1 is killed (kill -9)",
        }),
        ramps: &[],
        explain: failover_weld::explain,
    },
    Scene {
        name: "shared-tool",
        about: "three robots share a tip dresser: loosely coupled; one chatters, and dies with the tool in its hand",
        file: "shared_tool.cell",
        text: include_str!("../../examples/shared_tool.cell"),
        introduction: "\
Two welding robots and an inspector share a tool. While it is lent, weldA asks again every 50 ms with a
time_out of 20 ms, the others wait until they hear that it is free. A robot that is not back after 4 s loses it.",
        length: Duration::from_secs(12),
        moment: Some(Moment {
            task: "weldA",
            action: "dress",
            time: 1,
            after: ms(300),
            fault: Planned::Kill("na"),
            words: "while weldA has the tool its node is killed (kill -9)",
        }),
        ramps: &[],
        explain: shared_tool::explain,
    },
    Scene {
        name: "conveyor",
        about: "one robot picks from a belt and hands on to another: serially coupled; the camera stands still",
        file: "conveyor.cell",
        text: include_str!("../../examples/conveyor.cell"),
        introduction: "\
A camera reports where the parts on a belt are; a pose older than 66 ms is not used. pick takes
a part, meets place at `give`, and lets go when place holds the part.",
        length: Duration::from_secs(6),
        moment: Some(Moment {
            task: "pick",
            action: "open",
            time: 1,
            after: ms(10),
            fault: Planned::Pause("nc", ms(150)),
            words: "when pick has let go of its first part and is about to look for the next one, the camera stands still for 150 ms (--in-process: is cut off)",
        }),
        ramps: &[],
        explain: conveyor::explain,
    },
    Scene {
        name: "belt-administrator",
        about: "robots that share nothing but a belt: independent; two want another speed in the same tick",
        file: "belt.cell",
        text: include_str!("../../examples/belt.cell"),
        introduction: "\
The administrator of a belt reports its speed, with a version number, 20 times a second. r1 may want it
slower and r2 faster: both look when they hear the status, and so they ask at the same time.",
        length: Duration::from_secs(4),
        moment: None,
        ramps: &[],
        explain: belt_administrator::explain,
    },
];

impl ValueEnum for Scene {
    fn value_variants<'a>() -> &'a [Self] {
        SCENES
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name).help(self.about))
    }
}

impl Scene {
    fn source(&self) -> Source {
        Source { name: self.file.into(), text: self.text.into(), paper: false }
    }

    fn load(&self) -> Result<Loaded, Failure> {
        Ok(cells::load(&self.source())?)
    }
}

/// The cells of all demos.
pub fn cells() -> impl Iterator<Item = Loaded> {
    SCENES.iter().filter_map(|scene| scene.load().ok())
}

/// Runs the demo that the user chose.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &DemoArgs, out: &mut Output) -> Result<Exit, Failure> {
    let (options, loaded) = (&args.launch, args.cell.load()?);
    // The scene in `SCENES` is static, so its moment has the lifetime that the plan of the run needs.
    let scene = SCENES.iter().find(|scene| scene.name == args.cell.name);
    let own_faults =
        options.loss.0 > 0.0 || !options.kill.is_empty() || !options.cut.is_empty() || options.node.is_some();
    let moment = scene.and_then(|scene| scene.moment.as_ref()).filter(|_| !args.no_fault && !own_faults);
    let ramp = |&(action, since, over): &(&str, &str, Duration)| Ramp {
        action: action.into(),
        since: since.into(),
        over,
    };
    let demo = Some(DemoPlan { introduction: args.cell.introduction, moment, explain: args.cell.explain });
    let length = Some(options.length.unwrap_or(args.cell.length));
    let only = chosen(&loaded, options)?;
    let run = plan(args.cell.source(), &loaded, options, (length, only), demo)?;
    let ramps = args.cell.ramps.iter().map(ramp).collect();
    launch(Run { ramps, ..run }, options, demo, out)
}

/// The cell of the beam lift.
#[cfg(test)]
pub fn beam_lift() -> std::sync::Arc<imrs_protocol::CellTable> {
    std::sync::Arc::clone(&SCENES[0].load().expect("a sound cell").table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::TaskId;

    /// The time_out of a waitfor must be well above its margin (D65).
    #[test]
    fn the_beam_lift_leaves_time_to_meet_again() {
        let table = beam_lift();
        let lift = table.ports().iter().find(|port| port.decl.name == "lift").expect("the port");
        assert_eq!(lift.parties.len(), 3);
        assert!(lift.decl.time_out.0 > 10 * lift.margin.0, "{:?} on {:?}", lift.decl.time_out, lift.margin);
    }

    /// The explanation recognises why an arm has stopped by the handler in which it stopped.
    #[test]
    fn a_statement_of_a_handler_leads_to_its_head() {
        let (loaded, text) = (SCENES[0].load().expect("a sound cell"), SCENES[0].text);
        let lines = text.lines().enumerate().filter(|(_, line)| line.contains("run stop_now "));
        let stops: Vec<usize> = lines.map(|(at, _)| at + 1).collect();
        let arm = loaded.table.cell().tasks.iter().position(|task| task.name == "armR");
        let arm = TaskId::from_index(arm.expect("an arm"));
        let heads = stops.iter().map(|line| loaded.handler(arm, *line).map(|head| loaded.text_of(head)));
        let expected = ["on receive halt(s) do", "on silence beat 10 msec when me.moving do"].map(Some);
        // The first of these statements is in the body of the other arm, the others are in handlers.
        assert_eq!(heads.collect::<Vec<_>>(), [&[None][..], &expected].concat());
    }

    #[test]
    fn every_demo_is_of_a_sound_cell_and_its_fault_is_of_names_in_it() {
        for scene in SCENES {
            let loaded = scene.load().unwrap_or_else(|error| panic!("{}: {error}", scene.name));
            let cell = loaded.table.cell();
            let mut actions = Vec::new();
            actions.extend(scene.ramps.iter().flat_map(|(action, since, _)| [*action, *since]));
            actions.extend(scene.moment.map(|moment| moment.action));
            for action in actions {
                assert!(loaded.actions().any(|known| known == action), "{}: {action}", scene.name);
            }
            let Some(moment) = scene.moment else { continue };
            assert!(cell.tasks.iter().any(|task| task.name == moment.task), "{}", scene.name);
            let nodes = match moment.fault {
                Planned::Cut(ends, _) => ends.to_vec(),
                Planned::Kill(node) | Planned::Pause(node, _) => vec![node],
            };
            for node in nodes {
                assert!(cell.nodes.iter().any(|known| known.name == node), "{}: {node}", scene.name);
            }
        }
    }
}
