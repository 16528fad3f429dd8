"""Small recordings with maps, by hand: what the tests of formats read, alter and break."""

from __future__ import annotations


def _xy(x: float, y: float) -> str:
    return f"<point><x>{x}</x><y>{y}</y></point>"


def _state(x: float, y: float, heading: float, time: float, speed: float) -> str:
    return (
        f"<position>{_xy(x, y)}</position><orientation><exact>{heading}</exact></orientation>"
        f"<time><exact>{time}</exact></time><velocity><exact>{speed}</exact></velocity>"
    )


COMMONROAD = f"""<?xml version="1.0" encoding="utf-8"?>
<commonRoad benchmarkID="A_B-1_1_T-1" commonRoadVersion="2020a" timeStepSize="0.1">
<lanelet id="1"><leftBound>{_xy(0, 2)}{_xy(50, 2)}</leftBound>
<rightBound>{_xy(0, -2)}{_xy(50, -2)}</rightBound>
<successor ref="2"/><trafficSignRef ref="5"/><trafficLightRef ref="6"/></lanelet>
<lanelet id="2"><leftBound>{_xy(50, 2)}{_xy(90, 2)}</leftBound>
<rightBound>{_xy(50, -2)}{_xy(70, -2)}{_xy(90, -2)}</rightBound></lanelet>
<trafficSign id="5"><trafficSignElement><trafficSignID>274</trafficSignID>
<additionalValue>13.5</additionalValue></trafficSignElement></trafficSign>
<trafficLight id="6"><cycle><cycleElement><duration>300</duration><color>green</color>
</cycleElement><cycleElement><duration>30</duration><color>yellow</color></cycleElement>
<cycleElement><duration>270</duration><color>red</color></cycleElement></cycle></trafficLight>
<intersection id="7"><incoming id="8"><incomingLanelet ref="1"/><successorsStraight ref="2"/>
</incoming></intersection>
<dynamicObstacle id="30"><type>truck</type>
<shape><rectangle><length>8.5</length><width>2.5</width></rectangle></shape>
<initialState>{_state(1, 0, 0, 0, 10)}</initialState>
<trajectory><state>{_state(2, 0.5, 0.25, 1, 10.5)}</state></trajectory></dynamicObstacle>
<staticObstacle id="31"><type>parkedVehicle</type>
<initialState>{_state(9, -3, 0, 0, 0)}</initialState></staticObstacle>
<staticObstacle id="32"><type>pillar</type>
<initialState>{_state(9, -9, 0, 0, 0)}</initialState></staticObstacle>
</commonRoad>
"""
"""A truck and a parked car on two lanelets, the second of which is a junction."""
