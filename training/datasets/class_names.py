"""Which classes of two tables mean the same: the names of CamVid, Cityscapes, ADE20K and Mapillary.

References: Cordts et al. 2016 (Cityscapes), Zhou et al. 2017 (ADE20K), Neuhold et al. 2017
(Mapillary Vistas).
"""

import re
from collections.abc import Iterator, Sequence

from models.classes import CATEGORIES

# A line is a kind of thing, a class of CamVid. Between bars are the names of one meaning; the first
# of them stand for the whole kind, the others for a part of it: CamVid's car includes trucks.
_KINDS = """
sky
building, edifice, house, skyscraper | wall | bridge, span, overpass | tunnel | booth, kiosk |
    tower | hovel, hut, shed, garage
pole, post, column, pillar, utility pole | street light, streetlight, street lamp, lamp post |
    traffic sign frame, traffic sign back | polegroup, pole group
road, street, route, roadway, carriageway | lane marking, road marking,
    lane marking general, lane marking crosswalk, marking general, marking crosswalk zebra |
    crosswalk, crosswalk plain, zebra crossing | service lane, bike lane, bus lane, cycle lane |
    parking, parking aisle, driveway | manhole, pothole, catch basin | dirt track | rail track
pavement, sidewalk, footpath, footway, walkway, pedestrian area | curb, kerb, curb cut
tree, vegetation, trees, bush, shrub | plant, flora, plant life, hedge, palm, flower |
    terrain, grass, field, lawn, verge, earth, ground, soil, sand
sign, traffic sign, signboard, traffic sign front, road sign, sign symbol |
    traffic light, traffic signal, stoplight | billboard, banner, poster, hoarding
fence, fencing, barrier, other barrier | guard rail, guardrail, railing, rail, bannister |
    road barrier, separator, temporary barrier, concrete block, traffic cone, cone
car, auto, automobile, motorcar, passenger car, vehicle, vehicles | truck, motortruck, lorry |
    bus, autobus, coach | van, minivan | train, tram, on rails, streetcar | trailer |
    caravan, camper | other vehicle, construction vehicle, emergency vehicle, pickup, suv
pedestrian, person, people, individual, human, child
bicyclist, cyclist, rider, two wheeler | bicycle, bike, cycle | motorcycle, motorbike, minibike |
    motorcyclist, other rider | scooter, moped
"""
_MEANINGS = [
    [[name.strip() for name in group.split(",")] for group in kind.split("|")]
    for kind in re.sub(r"([,|])\s*\n\s*", r"\1", _KINDS).strip().splitlines()
]
# The kind and the meaning of each name.
_PLACES = {
    name: (kind, meaning)
    for kind, meanings in enumerate(_MEANINGS)
    for meaning, names in enumerate(meanings)
    for name in names
}


def relatives(name: str, known: Sequence[str]) -> tuple[str, ...]:
    """Return the names of `known` that mean the same as a class's name; () if there are none.

    These are the names that are equal (beyond case, hyphens and underscores), else those of the
    same meaning, else the classes of one of Cityscapes' categories, else the class of which it is
    a part. ADE20K's "car;auto" and Mapillary's "object--vehicle--car" are read, too.
    """
    spellings = list(_spellings(name))
    texts = {other: list(_spellings(other)) for other in known}
    equal = [other for other, found in texts.items() if spellings[0] == found[0]]
    if equal:
        return tuple(equal)
    places = {other: _place(found) for other, found in texts.items()}
    place = _place(spellings)
    category = next((CATEGORIES[text] for text in spellings if text in CATEGORIES), ())
    parts = tuple(other for other, found in texts.items() if not set(found).isdisjoint(category))
    if len(parts) > 1 or place is None:
        return parts
    same = tuple(other for other in known if places[other] == place)
    return same or tuple(other for other in known if places[other] == (place[0], 0))


def join_relatives(
    relatives: Sequence[Sequence[str]], known: Sequence[str]
) -> list[tuple[list[int], list[int]]]:
    """Return what can be compared between two lists of classes: ids of the one, and of the other.

    Args:
        relatives: for each class of the first list, the names in the second that it stands for.
        known: the second list. A class in it may be split in the first, and the other way round.
    """
    groups: list[tuple[list[int], list[int]]] = []
    folded = [name.casefold() for name in known]
    for index, names in enumerate(relatives):
        of = [folded.index(name.casefold()) for name in names if name.casefold() in folded]
        if not of:
            continue
        ids = [index]
        for group in [group for group in groups if not set(of).isdisjoint(group[1])]:
            groups.remove(group)
            ids, of = group[0] + ids, group[1] + [each for each in of if each not in group[1]]
        groups.append((ids, of))
    return groups


def _spellings(name: str) -> Iterator[str]:
    """Yield how a name may be spelled in the table: whole, then its parts."""
    *_, last = levels = name.split("--")
    yield _plain(" ".join(levels[-2:]))
    yield _plain(last)
    yield from map(_plain, re.split("[;,]", name))


def _plain(text: str) -> str:
    return " ".join(re.sub(r"[^\w]|_", " ", text.casefold()).split())


def _place(spellings: Sequence[str]) -> tuple[int, int] | None:
    """Return kind and meaning of the first spelling that is in the table."""
    return next((_PLACES[text] for text in spellings if text in _PLACES), None)
