//! Checks of declared couples, `couple work`: their port, their times and the ports that they guard (D30, D61).

use super::Port;
use crate::cell::{Cell, CellError, CoupleDecl, Usage};
use crate::margin::{DRIFT_PPM, least_lease, takeover_margin};
use crate::ticks::Ticks;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

/// Checks all couples, and the ports guarded by a lease. `bound` gives the path bound between two tasks.
pub(crate) fn check(
    cell: &Cell,
    ports: &[Port],
    bound: impl Fn(crate::ids::TaskId, crate::ids::TaskId) -> Ticks,
    errors: &mut Vec<CellError>,
) {
    if cell.couples.len() > usize::from(u8::MAX) {
        errors.push(CellError::TooMany("couples", usize::from(u8::MAX)));
    }
    for (i, couple) in cell.couples.iter().enumerate() {
        let known = |task: crate::ids::TaskId| task.index() < cell.tasks.len();
        if !known(couple.primary) || !known(couple.standby) || couple.primary == couple.standby {
            errors.push(CellError::Dangling(format!("couple {i}")));
            continue;
        }
        let Some(via) = ports.get(couple.via.index()) else {
            errors.push(CellError::Dangling(format!("couple {i}")));
            continue;
        };
        check_via(couple, via, errors);
        let delay = bound(couple.primary, couple.standby);
        check_times(cell, couple, via, ports, (i, delay), errors);
        for other in &cell.couples[..i] {
            let both = [other.primary, other.standby];
            if both.contains(&couple.primary) || both.contains(&couple.standby) {
                errors.push(CellError::CoupledTwice(name(cell, couple)));
            }
        }
    }
    check_guards(cell, ports, errors);
}

fn name(cell: &Cell, couple: &CoupleDecl) -> String {
    format!("{} -> {}", cell.tasks[couple.primary.index()].name, cell.tasks[couple.standby.index()].name)
}

/// Checks the heartbeats' port: it must join only the two tasks of the couple: the standby queries, the primary responds.
fn check_via(couple: &CoupleDecl, via: &Port, errors: &mut Vec<CellError>) {
    let usage = |task| via.parties.iter().find(|party| party.task == task).map(|party| party.usage);
    let fits = via.parties.len() == 2
        && usage(couple.primary) == Some(Usage::Response)
        && usage(couple.standby) == Some(Usage::Query);
    if !fits {
        errors.push(CellError::NotForHeartbeats(via.decl.name.clone()));
    }
}

fn check_times(
    cell: &Cell,
    couple: &CoupleDecl,
    via: &Port,
    ports: &[Port],
    (position, delay): (usize, Ticks),
    errors: &mut Vec<CellError>,
) {
    let renewed = least_lease(delay, couple.every, cell.tick);
    if couple.every.is_zero() || couple.lease < renewed {
        let (couple, lease) = (name(cell, couple), couple.lease);
        errors.push(CellError::LeaseTooShort { couple, lease, least: renewed });
        return;
    }
    let guarded = ports.iter().filter(|port| port.decl.guard.map(usize::from) == Some(position));
    let longest = |port: &Port| port.parties.iter().map(|party| party.time_out).max().unwrap_or_default();
    let residence = guarded.map(longest).max().unwrap_or(Ticks::ZERO);
    let margin = takeover_margin(couple.lease, couple.takeover, DRIFT_PPM, residence, cell.tick);
    // An answer of an earlier epoch must have expired before the next epoch begins.
    let least = (couple.lease + margin).max(longest(via));
    if couple.takeover < least && !couple.trusted {
        let (couple, takeover) = (name(cell, couple), couple.takeover);
        errors.push(CellError::TakeoverTooSoon { couple, takeover, least });
    }
}

fn check_guards(cell: &Cell, ports: &[Port], errors: &mut Vec<CellError>) {
    for port in ports {
        let Some(guard) = port.decl.guard else { continue };
        let Some(couple) = cell.couples.get(usize::from(guard)) else {
            errors.push(CellError::Dangling(format!("the guard of port `{}`", port.decl.name)));
            continue;
        };
        let senders = port.parties.iter().filter(|p| matches!(p.usage, Usage::Send | Usage::Query));
        let fits = port.decl.usage != Usage::Waitfor
            && senders.into_iter().all(|p| p.task == couple.primary || p.task == couple.standby);
        if !fits {
            errors.push(CellError::NotOfTheCouple(port.decl.name.clone()));
        }
    }
}
