//! Serves the state space of a claim in stateright's Explorer, which shows each path as a sequence chart.

use crate::cell::svg;
use crate::cell_state::{self, CellState};
use crate::chart::{self, ChartRecorder};
use crate::claims::Explored;
use crate::explore::{Ground, Grounded, Limits};
use crate::state::Packed;
use crate::world::World;
use stateright::{Model, Path, Property};
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// Why the Explorer is not served.
#[derive(Debug)]
pub enum ExplorerError {
    /// The address is not loopback: the Explorer has no authentication.
    NotLoopback(SocketAddr),
    /// No claim has this name, or the claim needs no search of states.
    NothingToExplore,
    /// The Explorer cannot listen on this address.
    Unavailable(SocketAddr, io::Error),
}

impl std::fmt::Display for ExplorerError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NotLoopback(address) => {
                write!(f, "other machines can reach {address}: serve 127.0.0.1:PORT or [::1]:PORT")
            }
            Self::NothingToExplore => {
                f.write_str("this claim is settled without a search: there is nothing to explore")
            }
            Self::Unavailable(address, error) => write!(f, "{address}: {error}"),
        }
    }
}

impl std::error::Error for ExplorerError {}

/// The first state space of a claim, ready to be explored.
#[derive(Clone, Debug)]
pub struct Explorer(Explored);

impl Explorer {
    /// The first state space that the rows of a claim explore.
    ///
    /// # Errors
    /// [`ExplorerError::NothingToExplore`], if there is no such state space.
    pub fn of_claim(name: &str) -> Result<Self, ExplorerError> {
        crate::claims::first_explored(name).map(Self).ok_or(ExplorerError::NothingToExplore)
    }

    /// Serves the Explorer until the process ends. Calls `ready` with the address first. Port 0 stands for any free port.
    pub fn serve(
        self,
        address: SocketAddr,
        limits: Limits,
        ready: impl FnOnce(SocketAddr),
    ) -> Result<(), ExplorerError> {
        if !address.ip().is_loopback() {
            return Err(ExplorerError::NotLoopback(address));
        }
        // stateright panics if it cannot bind, so the address is tried first. This also finds a free port.
        let probe = TcpListener::bind(address).and_then(|probe| probe.local_addr());
        let address = probe.map_err(|error| ExplorerError::Unavailable(address, error))?;
        ready(address);
        match self.0 {
            Explored::World(scenario) => {
                let pad = World::new(&scenario);
                let path_chart = Arc::clone(&scenario);
                let drawn = Drawn {
                    grounded: Grounded::new(pad, limits, None),
                    path_chart: Box::new(move |states| chart::walk(&path_chart, states)),
                    step: Box::new(move |state, action| chart::one_step(&scenario, state, action)),
                };
                drop(drawn.checker().serve(address));
            }
            Explored::CellState(plan) => {
                let pad = CellState::new(&plan);
                let path_chart = Arc::clone(&plan);
                let drawn = Drawn {
                    grounded: Grounded::new(pad, limits, None),
                    path_chart: Box::new(move |states| cell_state::chart::walk(&path_chart, states)),
                    step: Box::new(move |state, step| cell_state::chart::one_step(&plan, state, step)),
                };
                drop(drawn.checker().serve(address));
            }
        }
        Ok(())
    }
}

/// A function that draws the path through these states.
type PathChart = Box<dyn Fn(&[Packed]) -> Option<ChartRecorder> + Send + Sync>;
/// A function that draws one step from a state.
type OneStep<A> = Box<dyn Fn(&Packed, A) -> ChartRecorder + Send + Sync>;

/// A state space as a stateright model that draws its paths and steps.
struct Drawn<G: Ground> {
    grounded: Grounded<G>,
    path_chart: PathChart,
    step: OneStep<G::Action>,
}

impl<G: Ground + 'static> Model for Drawn<G> {
    type State = Packed;
    type Action = G::Action;

    fn init_states(&self) -> Vec<Packed> {
        self.grounded.init_states()
    }

    fn actions(&self, state: &Packed, actions: &mut Vec<G::Action>) {
        self.grounded.actions(state, actions);
    }

    fn next_state(&self, state: &Packed, action: G::Action) -> Option<Packed> {
        self.grounded.next_state(state, action)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![Property::always("claim", |_, state: &Packed| state.violation().is_none())]
    }

    /// A step and its violation in words, because the bytes of a state mean nothing to a person.
    fn format_step(&self, state: &Packed, action: G::Action) -> Option<String> {
        let wrong = self.next_state(state, action)?.violation();
        // A step that panics leaves no notes. The violation below reports the panic.
        let recorder = catch_unwind(AssertUnwindSafe(|| (self.step)(state, action))).ok();
        let words = recorder
            .iter()
            .flat_map(|recorder| recorder.notes.iter().map(|note| note.words(recorder.names())));
        let words = words.chain(wrong.map(|wrong| format!("=> {}", wrong.text())));
        Some(words.collect::<Vec<_>>().join("\n"))
    }

    fn as_svg(&self, path: Path<Packed, G::Action>) -> Option<String> {
        let cause = path.last_state().violation().map_or("", |violation| violation.text());
        let states = path.into_states();
        // Replaying a path to a panic of the state machine panics again.
        let recorder = catch_unwind(AssertUnwindSafe(|| (self.path_chart)(&states))).ok()??;
        Some(svg(recorder.names(), &recorder.notes, cause))
    }
}
