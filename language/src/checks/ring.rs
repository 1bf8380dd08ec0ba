//! Finds rings (cycles) in directed graphs.

/// The greatest number of rings for which one search looks.
const MOST: usize = 10;

/// Rings among `size` vertices with these edges, the shortest first. No two rings share an edge.
pub(super) fn all(size: usize, edges: &[(usize, usize)]) -> Vec<Vec<usize>> {
    let mut edges = edges.to_vec();
    let mut rings = Vec::new();
    while let Some(ring) = shortest(size, &edges).filter(|_| rings.len() < MOST) {
        let steps: Vec<(usize, usize)> =
            ring.iter().copied().zip(ring.iter().copied().cycle().skip(1)).collect();
        edges.retain(|edge| !steps.contains(edge));
        rings.push(ring);
    }
    rings
}

/// The shortest ring. If there are several, the ring with the least first vertex.
fn shortest(size: usize, edges: &[(usize, usize)]) -> Option<Vec<usize>> {
    (0..size).filter_map(|start| back_to(start, size, edges)).min_by_key(Vec::len)
}

/// The shortest ring that leads from the vertex `start` through vertices with greater numbers back to `start`.
fn back_to(start: usize, size: usize, edges: &[(usize, usize)]) -> Option<Vec<usize>> {
    let mut from: Vec<Option<usize>> = vec![None; size];
    let mut at = vec![start];
    while !at.is_empty() {
        let mut next = Vec::new();
        for &point in &at {
            for &(_, to) in edges.iter().filter(|edge| edge.0 == point) {
                if to == start {
                    return Some(way(start, point, &from));
                }
                if to > start && from[to].is_none() {
                    from[to] = Some(point);
                    next.push(to);
                }
            }
        }
        at = next;
    }
    None
}

fn way(start: usize, end: usize, from: &[Option<usize>]) -> Vec<usize> {
    let mut way = vec![end];
    while let Some(before) = way.last().filter(|&&last| last != start).and_then(|&last| from[last]) {
        way.push(before);
    }
    way.reverse();
    way
}

#[cfg(test)]
mod tests {
    use super::{all, shortest};

    #[test]
    fn the_shortest_ring_is_found() {
        assert_eq!(shortest(4, &[(0, 1), (1, 2), (2, 0), (2, 3), (3, 2)]), Some(vec![2, 3]));
        assert_eq!(shortest(3, &[(0, 1), (1, 2), (2, 0)]), Some(vec![0, 1, 2]));
        assert_eq!(shortest(3, &[(0, 1), (1, 2), (0, 2)]), None);
        assert_eq!(all(4, &[(0, 1), (1, 0), (2, 3), (3, 2)]), [vec![0, 1], vec![2, 3]]);
    }
}
