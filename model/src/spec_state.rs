//! The specification state of a world: what the judge of a property must remember, but no task of the cell can see.

use crate::scenario::{Behaviour, Scenario, Watch};
use crate::state::Violation;
use imrs_protocol::{
    Contents, Event, Frame, MessageId, Observation, Outcome, Overflow, ReplyTo, Round, Seq24, Signal, TaskId,
};

/// The specification state of one task: the rounds and counts that the property needs, and how many attempts or sends the
/// task has left.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct SpecState {
    /// How many attempts or sends the task has left; [`SpecState::ENDLESS`] for no limit.
    pub left: u8,
    /// The round in which the task waits.
    pub waits_in: Option<Round>,
    /// Rounds that the task announced: bit `i` stands for round `base + i`, with the base of [`Judge`].
    pub announced: u32,
    /// Rounds from which the task was released, in a bit mask like `announced`.
    pub released: u32,
    /// Rounds that the task left without a release, in a bit mask like `announced`.
    pub gave_up: u32,
    /// Rounds that another member had left when this node restarted, so that the new incarnation cannot meet that member
    /// there; in a bit mask like `announced`.
    pub missed: u32,
    /// How often the task reached the waitfor. The next fields say how often it was released, and from which round last.
    /// The property `Pairing` needs them.
    pub reached: u8,
    pub releases: u8,
    pub last_released: Option<Round>,
    /// How many attempts the task has made since the faults ended, up to its first release after the end of the faults.
    pub since_heal: u8,
    /// Whether the task was released since the faults ended.
    pub met: bool,
    /// The command that the task has taken and must answer.
    pub serving: Option<ReplyTo>,
    /// Ticks since the task's outstanding command was sent, or since its wait at the waitfor began.
    pub open: Option<u8>,
    /// A bit mask: bit `i` says that the task's message `next - 1 - i` was handed over.
    pub executed: u8,
    /// The true remaining times of the task's status messages: `(sequence, ticks)`.
    pub statuses: Vec<(Seq24, u8)>,
}

impl SpecState {
    pub const ENDLESS: u8 = u8::MAX;

    pub fn new(behaviour: Behaviour) -> Self {
        let left = match behaviour {
            Behaviour::Member { attempts, .. } => attempts.unwrap_or(Self::ENDLESS),
            Behaviour::Sender { sends, .. } => sends,
            Behaviour::Receiver => 0,
        };
        Self { left, ..Self::default() }
    }

    pub fn use_one(&mut self) {
        if self.left != Self::ENDLESS {
            self.left = self.left.saturating_sub(1);
        }
    }
}

fn bit(round: Round, base: Round) -> Result<u32, Violation> {
    1_u32.checked_shl(u32::from(round.steps_from(base))).ok_or(Violation::Overflow)
}

/// Judges the effects of one step. `base` is the round for which bit 0 of each bit mask stands.
pub(crate) struct Judge<'a> {
    pub scenario: &'a Scenario,
    pub spec_states: &'a mut [SpecState],
    pub healed: bool,
    pub base: Round,
    /// Whether the property was shown to be reachable. If so, the state is final.
    pub done: bool,
}

impl Judge<'_> {
    pub fn observed(&mut self, at: TaskId, seen: &Observation) -> Result<(), Violation> {
        #[expect(clippy::cast_possible_truncation, reason = "a round observed is 16 bits wide")]
        let round = Round(seen.number as u16);
        let spec_state = &mut self.spec_states[at.index()];
        match seen.event {
            Event::Reached | Event::Rejoined => {
                if let Some(old) = spec_state.waits_in {
                    spec_state.gave_up |= bit(old, self.base)?;
                }
                spec_state.announced |= bit(round, self.base)?;
                spec_state.waits_in = Some(round);
                if seen.event == Event::Reached {
                    spec_state.reached = spec_state.reached.saturating_add(1);
                    if self.healed && !spec_state.met {
                        spec_state.since_heal = spec_state.since_heal.saturating_add(1);
                    }
                }
            }
            Event::GaveUp => {
                spec_state.gave_up |= bit(round, self.base)?;
                spec_state.waits_in = None;
                spec_state.open = None;
                let all_reached = self.spec_states.iter().all(|g| g.announced != 0);
                if self.scenario.watch == Watch::GaveUpAfterAllArrived && all_reached {
                    return Err(Violation::GaveUpAfterAllArrived);
                }
            }
            _ => {}
        }
        if let Watch::MeetAgain { attempts } = self.scenario.watch
            && self.spec_states[at.index()].since_heal > attempts
        {
            return Err(Violation::NotMet);
        }
        Ok(())
    }

    pub fn signalled(
        &mut self,
        at: TaskId,
        signal: &Signal,
        awaits: impl Fn(TaskId) -> Option<(TaskId, MessageId)>,
    ) -> Result<(), Violation> {
        match signal {
            Signal::Released { round, .. } => self.released(at, *round),
            Signal::Message(delivery) => {
                let source = delivery.from.source;
                let command = delivery.class == imrs_protocol::Class::Command;
                if command {
                    self.spec_states[at.index()].serving = Some(delivery.from);
                    // The first byte of the contents identifies the command, even if sequence numbers wrap.
                    let left = delivery.contents.as_bytes().first().copied().unwrap_or(0);
                    let back = left.saturating_sub(self.spec_states[source.index()].left).saturating_add(1);
                    self.executed(source, back)?;
                }
                if self.scenario.watch == Watch::Stale {
                    let alive = if command {
                        awaits(source) == Some((at, delivery.from.id))
                    } else {
                        let statuses = &self.spec_states[source.index()].statuses;
                        statuses.iter().any(|&(sequence, _)| sequence == delivery.from.id.sequence)
                    };
                    if !alive {
                        return Err(Violation::Stale);
                    }
                }
                Ok(())
            }
            Signal::Outcome(outcome) => self.ended(at, outcome),
            _ => Ok(()),
        }
    }

    fn released(&mut self, at: TaskId, round: Round) -> Result<(), Violation> {
        let bit = bit(round, self.base)?;
        let spec_state = &mut self.spec_states[at.index()];
        spec_state.released |= bit;
        spec_state.waits_in = None;
        spec_state.open = None;
        spec_state.releases = spec_state.releases.saturating_add(1);
        spec_state.last_released = Some(round);
        let releases = spec_state.releases;
        match self.scenario.watch {
            Watch::FalseRelease
                if self.spec_states.iter().any(|g| g.announced & bit == 0)
                    || self.spec_states[at.index()].missed & bit != 0 =>
            {
                Err(Violation::FalseRelease)
            }
            Watch::Pairing if self.spec_states.iter().any(|g| g.reached < releases) => {
                Err(Violation::FalseRelease)
            }
            Watch::Pairing => {
                let same = |g: &SpecState| g.releases != releases || g.last_released == Some(round);
                let ahead = |g: &SpecState| g.releases > releases;
                if self.spec_states.iter().all(|g| same(g) && !ahead(g)) {
                    Ok(())
                } else {
                    Err(Violation::Unpaired)
                }
            }
            Watch::Reachable => Err(Violation::Released),
            Watch::MeetAgain { .. } => {
                self.spec_states[at.index()].met = self.healed;
                self.done = self.spec_states.iter().all(|spec_state| spec_state.met);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Records that a command of `source` was handed over. It is the command that `source` sent `back - 1` commands before
    /// its last command.
    fn executed(&mut self, source: TaskId, back: u8) -> Result<(), Violation> {
        let bit = 1_u8.checked_shl(u32::from(back.saturating_sub(1))).ok_or(Violation::Overflow)?;
        let spec_state = &mut self.spec_states[source.index()];
        let again = spec_state.executed & bit != 0;
        spec_state.executed |= bit;
        if again && self.scenario.watch == Watch::AtMostOnce { Err(Violation::ExecutedTwice) } else { Ok(()) }
    }

    fn ended(&mut self, at: TaskId, outcome: &Outcome) -> Result<(), Violation> {
        let spec_state = &mut self.spec_states[at.index()];
        let open = spec_state.open.take();
        if self.scenario.watch == Watch::Answered && !matches!(outcome, Outcome::Reply(_)) {
            return Err(Violation::Unanswered);
        }
        if !matches!(self.scenario.watch, Watch::Resolves | Watch::ResolvesOnce) {
            return Ok(());
        }
        if open.is_none() {
            return Err(Violation::SecondOutcome);
        }
        match outcome {
            Outcome::Reply(contents) if *contents != question(spec_state.left) => Err(Violation::WrongAnswer),
            _ => Ok(()),
        }
    }

    /// Judges all rounds after a step: if one member was released from a round, no member may leave that round without a
    /// release.
    pub fn judge_round(&self) -> Result<(), Violation> {
        if self.scenario.watch != Watch::AllOrNone {
            return Ok(());
        }
        let released = self.spec_states.iter().fold(0, |mask, g| mask | g.released);
        let left = self.spec_states.iter().fold(0, |mask, g| mask | g.gave_up);
        if released & left == 0 { Ok(()) } else { Err(Violation::Divergent) }
    }
}

/// The contents of a command. `left` is how many commands the sender still sends after this one. The answer must repeat
/// these contents.
pub(crate) fn question(left: u8) -> Contents {
    Contents::new(&[left]).unwrap_or_default()
}

/// Packs the part of a task's specification state that the property needs. `shift` is how many rounds the base of the bit
/// masks has moved.
pub(crate) fn store(
    spec_state: &SpecState,
    watch: Watch,
    frame: &Frame<'_>,
    shift: u32,
    task: TaskId,
    least: u8,
    out: &mut Vec<u8>,
) -> Result<(), Overflow> {
    let mask = |mask: u32| u8::try_from(mask.checked_shr(shift).unwrap_or(0)).map_err(|_| Overflow);
    out.push(spec_state.left);
    match watch {
        Watch::FalseRelease => {
            out.push(mask(spec_state.announced)?);
            if frame.incarnations {
                out.push(mask(spec_state.missed)?);
            }
        }
        Watch::AllOrNone => out.extend([mask(spec_state.released)?, mask(spec_state.gave_up)?]),
        Watch::Pairing => {
            let round = match spec_state.last_released {
                Some(round) => u8::try_from(round.steps_from(frame.rounds[0]) + 1).map_err(|_| Overflow)?,
                None => 0,
            };
            out.extend([spec_state.reached - least, spec_state.releases - least, round]);
        }
        Watch::MeetAgain { .. } => out.extend([spec_state.since_heal, u8::from(spec_state.met)]),
        Watch::GaveUpAfterAllArrived | Watch::Stranded => out.push(u8::from(spec_state.announced != 0)),
        Watch::Reachable => {}
        Watch::Stale
        | Watch::Resolves
        | Watch::ResolvesOnce
        | Watch::Answered
        | Watch::AtMostOnce
        | Watch::Waits => {
            let next = |task: TaskId| frame.sequences.get(task.index()).copied().unwrap_or_default();
            match spec_state.serving {
                None => out.push(0),
                Some(to) => {
                    let back = next(to.source).steps_from(to.id.sequence);
                    out.push(u8::try_from(to.source.index() + 1).map_err(|_| Overflow)?);
                    out.extend([u8::try_from(to.port.index()).map_err(|_| Overflow)?, to.id.incarnation.0]);
                    out.push(u8::try_from(back).map_err(|_| Overflow)?);
                }
            }
            match watch {
                Watch::Resolves | Watch::ResolvesOnce | Watch::Waits => {
                    out.push(spec_state.open.map_or(0, |ticks| ticks.saturating_add(1)));
                }
                Watch::AtMostOnce => out.push(spec_state.executed),
                _ => {
                    out.push(u8::try_from(spec_state.statuses.len()).map_err(|_| Overflow)?);
                    for &(sequence, left) in &spec_state.statuses {
                        let back = next(task).steps_from(sequence);
                        out.extend([u8::try_from(back).map_err(|_| Overflow)?, left]);
                    }
                }
            }
        }
    }
    Ok(())
}

/// Unpacks the specification state of one task. Returns the number of bytes read.
pub(crate) fn load(spec_state: &mut SpecState, watch: Watch, incarnations: bool, bytes: &[u8]) -> usize {
    let mut at = 0;
    let mut byte = || {
        let byte = bytes.get(at).copied().unwrap_or(0);
        at += 1;
        byte
    };
    let statuses = std::mem::take(&mut spec_state.statuses);
    *spec_state = SpecState { left: byte(), statuses, ..SpecState::default() };
    spec_state.statuses.clear();
    let sequence = |back: u8| Frame::SEQUENCE.plus(Seq24::MODULUS - u32::from(back));
    match watch {
        Watch::FalseRelease => {
            spec_state.announced = u32::from(byte());
            if incarnations {
                spec_state.missed = u32::from(byte());
            }
        }
        Watch::AllOrNone => {
            (spec_state.released, spec_state.gave_up) = (u32::from(byte()), u32::from(byte()));
        }
        Watch::Pairing => {
            (spec_state.reached, spec_state.releases) = (byte(), byte());
            spec_state.last_released = byte().checked_sub(1).map(|round| Frame::ROUND.plus(u16::from(round)));
        }
        Watch::MeetAgain { .. } => (spec_state.since_heal, spec_state.met) = (byte(), byte() == 1),
        Watch::GaveUpAfterAllArrived | Watch::Stranded => spec_state.announced = u32::from(byte()),
        Watch::Reachable => {}
        Watch::Stale
        | Watch::Resolves
        | Watch::ResolvesOnce
        | Watch::Answered
        | Watch::AtMostOnce
        | Watch::Waits => {
            if let Some(source) = byte().checked_sub(1) {
                let (port, incarnation, back) = (byte(), byte(), byte());
                let id = MessageId {
                    incarnation: imrs_protocol::Incarnation(incarnation),
                    sequence: sequence(back),
                };
                let (source, port) = (TaskId(u16::from(source)), imrs_protocol::PortId(u16::from(port)));
                spec_state.serving = Some(ReplyTo { port, source, id });
            }
            match watch {
                Watch::Resolves | Watch::ResolvesOnce | Watch::Waits => {
                    spec_state.open = byte().checked_sub(1);
                }
                Watch::AtMostOnce => spec_state.executed = byte(),
                _ => {
                    for _ in 0..byte() {
                        let (back, left) = (byte(), byte());
                        spec_state.statuses.push((sequence(back), left));
                    }
                }
            }
        }
    }
    at
}
