# The frame of frame_model.py for the program OpenSees, as a template: activefail fills in the values of frame.toml.
#
#     [simulator]
#     command = "OpenSees frame.tcl"
#     template = "frame.tcl"
#
# frame_model.py has the comments; the order of the parts is the same. One word in braces is a quantity to activefail, so a single
# argument of a procedure has blanks in its braces.

set T_b {T_b}; set mu {mu}; set D_tot {D_tot}; set Cy {Cy}
set storeys {storeys}; set bays {bays}; set storeyHeight {storey_height}; set bay {bay}
set floorMass {floor_mass}; set frameShare {frame_share}
set T_s {T_s}; set E {E}; set I_beam {I_beam}; set I_column {I_column}; set columnRatio {column_ratio}; set damping {damping}
set ofBeam [list {beam_capping} {beam_softening} {beam_energy}]
set ofColumn [list {column_capping} {column_softening} {column_energy}]
set rimStrength {rim_strength}; set rimYield {rim_yield}; set rimLimit {rim_limit}; set rimHeight {rim_height}
set driftLimit {drift_limit}; set step {time_step}
set recordFile "{record}"; set recordStep {record_dt}

set g 9.81
set pi [expr acos(-1.0)]
set hinge 10.0                                 ;# stiffness of a hinge over that of its member
set mobilised 1e-3                             ;# displacement that mobilises friction [m]
set pad 4.0                                    ;# time after the strong part [s]
set tolerance 1e-5; set iterations 10
set mostTrouble 800; set deepest 4
set diverged 0.6                               ;# share of the drift limit beyond which divergence is collapse
set storeys [expr int($storeys)]; set bays [expr int($bays)]
set leaning [expr $bays + 1]
set W [expr ($storeys + 1) * $floorMass * $g]
set period [expr $T_s * sqrt(0.25 / $Cy)]

proc at {column floor} { return [expr 100 * $floor + 10 * $column] }

proc share { column } {
    global bays leaning frameShare
    if {$column == $leaning} { return [expr 1.0 - $frameShare] }
    if {$column == 0 || $column == $bays} { return [expr $frameShare * 0.5 / $bays] }
    return [expr $frameShare * 1.0 / $bays]
}

proc addHinge {from to moment stiffness kind} {
    global hinges hinge
    incr hinges
    lassign $kind capping softening energy
    uniaxialMaterial IMKBilin [expr 1000 + $hinges] [expr $hinge * $stiffness] \
        $capping $softening 0.5 $moment 1.1 0.3 $capping $softening 0.5 $moment 1.1 0.3 \
        $energy $energy $energy 1.0 1.0 1.0 1.0 1.0
    equalDOF $from $to 1 2
    element zeroLength [expr 50000 + $hinges] $from $to -mat [expr 1000 + $hinges] -dir 6
}

proc addMember {first last i j moment area inertia long transformation kind stiffness} {
    global members hinge E
    node $i {*}[nodeCoord $first]
    node $j {*}[nodeCoord $last]
    set own [expr 6.0 * $E * $stiffness * $inertia / $long]
    addHinge $first $i $moment $own $kind
    addHinge $last $j $moment $own $kind
    set number [expr [llength $members] + 1]
    element elasticBeamColumn $number $i $j $area $E [expr (1.0 + 1.0 / $hinge) * $inertia * $stiffness] $transformation
    lappend members $number
}

# Build the frame; `stiffness` multiplies that of all members and hinges.
proc build {stiffness isolated} {
    global storeys bays leaning storeyHeight bay floorMass W g pi T_b mu Cy E I_beam I_column columnRatio
    global ofBeam ofColumn mobilised members hinges
    wipe
    model basic -ndm 2 -ndf 3
    for {set floor 0} {$floor <= $storeys} {incr floor} {
        for {set column 0} {$column <= $leaning} {incr column} {
            node [at $column $floor] [expr $column * $bay] [expr $floor * $storeyHeight]
            set m [expr [share $column] * $floorMass]
            mass [at $column $floor] $m $m 1.0
        }
        equalDOF [at $bays $floor] [at $leaning $floor] 1
        fix [at $leaning $floor] 0 0 1
    }
    set squares 0.0; set sum 0.0
    for {set level 1} {$level <= $storeys} {incr level} {
        set squares [expr $squares + $level * $level]
        set sum [expr $sum + $level]
    }
    set overturning [expr $Cy * $storeys * $floorMass * $g * $storeyHeight * $squares / $sum]
    set beam [expr $overturning / (2 * $bays * $storeys + ($bays + 1) * $columnRatio)]
    set strong [expr $columnRatio * $beam]

    set members {}
    set hinges 0
    geomTransf Linear 1
    geomTransf PDelta 2
    for {set floor 1} {$floor <= $storeys} {incr floor} {
        for {set b 0} {$b < $bays} {incr b} {
            set first [at $b $floor]; set last [at [expr $b + 1] $floor]
            addMember $first $last [expr $first + 1] [expr $last + 2] $beam 0.3 $I_beam $bay 1 $ofBeam $stiffness
        }
    }
    for {set storey 0} {$storey < $storeys} {incr storey} {
        for {set column 0} {$column < $leaning} {incr column} {
            set first [at $column $storey]; set last [at $column [expr $storey + 1]]
            addMember $first $last [expr $first + 3] [expr $last + 4] $strong 0.05 $I_column $storeyHeight 2 $ofColumn \
                $stiffness
        }
        uniaxialMaterial Elastic [expr 900 + $storey] $E
        element corotTruss [expr 800 + $storey] [at $leaning $storey] [at $leaning [expr $storey + 1]] 0.5 \
            [expr 900 + $storey]
    }
    for {set b 0} {$b < $bays} {incr b} {
        element elasticBeamColumn [expr 700 + $b] [at $b 0] [at [expr $b + 1] 0] 0.3 $E 5e-3 1
        lappend members [expr 700 + $b]
    }
    if {!$isolated} {
        for {set column 0} {$column <= $leaning} {incr column} { fix [at $column 0] 1 1 [expr $column < $leaning] }
        return
    }
    set long [expr $g * pow($T_b / (2.0 * $pi), 2)]
    frictionModel Coulomb 1 $mu
    uniaxialMaterial Elastic 2 1.0
    for {set column 0} {$column <= $leaning} {incr column} {
        set load [expr [share $column] * $W]
        set top [at $column 0]
        node [expr $top + 5] [expr $column * $bay] 0.0
        fix [expr $top + 5] 1 1 1
        uniaxialMaterial ElasticMultiLinear [expr 20 + $column] 0.0 -strain -1.0 1e-5 1.0 \
            -stress [expr -$load / 1e-3] [expr 0.01 * $load] [expr 0.1 * $load]
        element singleFPBearing [expr 600 + $column] [expr $top + 5] $top 1 $long \
            [expr $load * ($mu / $mobilised + 1.0 / $long)] -P [expr 20 + $column] -Mz 2 \
            -orient 0.0 1.0 0.0 -1.0 0.0 0.0 -iter 100 [expr 1e-6 * $load]
    }
}

proc solver {within most} {
    constraints Transformation
    numberer RCM
    system BandGeneral
    test NormDispIncr $within $most
    algorithm Newton
}

# Advance by a step; returns whether it converged.
proc advance {dt depth} {
    global troubled mostTrouble deepest tolerance iterations
    if {[analyze 1 $dt] == 0} { return 1 }
    incr troubled
    if {$troubled > $mostTrouble} { return 0 }
    test NormDispIncr [expr $tolerance * ($depth ? 10.0 : 1.0)] 25
    algorithm KrylovNewton
    set failed [analyze 1 $dt]
    if {$failed != 0 && $depth >= 2} {
        algorithm NewtonLineSearch 0.8
        set failed [analyze 1 $dt]
    }
    test NormDispIncr $tolerance $iterations
    algorithm Newton
    if {$failed == 0} { return 1 }
    if {$depth >= $deepest} { return 0 }
    for {set quarter 0} {$quarter < 4} {incr quarter} {
        if {![advance [expr $dt / 4.0] [expr $depth + 1]]} { return 0 }
    }
    return 1
}

# The frame, its weight, and its rim.
build 1.0 0
set own [expr 2.0 * $pi / sqrt([lindex [eigen -genBandArpack 2] 0])]
build [expr pow($own / $period, 2)] 1
timeSeries Constant 1
pattern Plain 1 1 {
    for {set floor 0} {$floor <= $storeys} {incr floor} {
        for {set column 0} {$column <= $leaning} {incr column} {
            load [at $column $floor] 0.0 [expr -[share $column] * $floorMass * $g] 0.0
        }
    }
}
solver 1e-8 50
integrator LoadControl 0.1
analysis Static
if {[analyze 10] != 0} { puts stderr "no equilibrium under the weight"; exit 1 }
loadConst -time 0.0
wipeAnalysis
set force [expr $rimStrength * $W]
node 9001 0.0 0.0
fix 9001 1 1 1
uniaxialMaterial ElasticPPGap 41 [expr $force / $rimYield] $force $D_tot 0.02 damage
uniaxialMaterial ElasticPPGap 42 [expr $force / $rimYield] [expr -$force] [expr -$D_tot] 0.02 damage
element zeroLength 650 9001 [at 0 0] -mat 41 42 -dir 1 1
region 1 -ele {*}$members -rayleigh 0.0 0.0 [expr $damping * $period / $pi] 0.0

# The strong part of the record.
set file [open $recordFile]
set samples {}
foreach line [split [read $file] \n] { if {[string trim $line] ne ""} { lappend samples [string trim $line] } }
close $file
set energy {}
set sum 0.0
foreach a $samples { lappend energy [set sum [expr $sum + $a * $a]] }
set first 0
while {[lindex $energy $first] / $sum < 1e-4} { incr first }
set last 0
while {[lindex $energy $last] / $sum < 0.997} { incr last }
set strong [lrange $samples [expr max($first - 1, 0)] $last]
set end [expr [llength $strong] * $recordStep + $pad]

timeSeries Path 2 -dt $recordStep -values {*}$strong
pattern UniformExcitation 2 1 -accel 2
solver $tolerance $iterations
integrator HHT 0.9
analysis Transient
for {set column 0} {$column < $leaning} {incr column} { set rest($column) [nodeDisp [at $column 0] 2] }
set troubled 0; set drift 0.0; set peak 0.0; set uplift 0.0; set touch 0.0; set cause ""
while {[getTime] < $end - 1e-9 && $cause eq ""} {
    if {![advance $step 0]} {
        if {$drift < $diverged * $driftLimit} { puts stderr "no convergence at [getTime] s, with a drift of $drift"; exit 1 }
        set cause divergence
        break
    }
    set x [expr abs([nodeDisp [at 0 0] 1])]
    if {$x >= $D_tot && $touch == 0.0} { set touch [expr abs([nodeVel [at 0 0] 1])] }
    set peak [expr max($peak, $x)]
    for {set floor 0} {$floor < $storeys} {incr floor} {
        set between [expr [nodeDisp [at 0 [expr $floor + 1]] 1] - [nodeDisp [at 0 $floor] 1]]
        set drift [expr max($drift, abs($between) / $storeyHeight)]
    }
    set lift 0.0
    for {set column 0} {$column < $leaning} {incr column} {
        set lift [expr max($lift, [nodeDisp [at $column 0] 2] - $rest($column))]
    }
    set uplift [expr max($uplift, $lift)]
    if {$x > $D_tot + $rimLimit} {
        set cause rim
    } elseif {$lift > $rimHeight && $x > $D_tot} {
        set cause uplift
    } elseif {$drift > $driftLimit} {
        set cause drift
    }
}

set margins [format {"peak_drift": %.17g, "displacement_ratio": %.17g, "uplift": %.17g, "touch_velocity": %.17g} \
    $drift [expr $peak / $D_tot] $uplift $touch]
set answer [open $env(AF_OUT) w]
puts $answer "{\"outcome\": \"[expr {$cause eq "" ? "safe" : "collapse"}]\", \"cause\": \"$cause\", \"margins\": {$margins, \"troubled_steps\": $troubled.0}}"
close $answer
